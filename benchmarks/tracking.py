"""`python -m benchmarks.tracking`: random trajectories, tracked from rendered frames, against the true paths.

One letter of 1 cm, or several of 3 to 5 mm, move at 0.01 to 20 mm/s along curved paths, some with a vibration, and are photographed
30 to 2000 times per second with 0.003 to 0.3 photoelectrons per pixel; the laser is at rest. Errors are those of the path after its
mean difference to the truth is removed. Each is compared with 2 um and with the Cramer-Rao bound (`path_bound.py`).

`--images` also reconstructs each object that was found, and compares it with its letter; and what all objects together show.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

import correlograph as cg
from benchmarks.path_bound import bounds_m
from correlograph.files.images import read_image
from correlograph.files.output import save_json
from scenes import scene_path
from sim.frame import Simulation
from sim.geometry import Geometry

FRAMES = 40
SHAPE = (560, 640)
LETTERS = ("F", "R", "L", "t", "5", "7")

OBJECT = """
    <shape type="rectangle" id="hidden_object_{number}">
        <transform name="to_world">
            <scale x="{half}" y="{half}"/><rotate z="1" angle="180"/><translate x="{x}" y="{y}"/>
        </transform>
        <bsdf type="phase_screen">
            <float name="height_rms" value="2e-6"/><float name="correlation_length" value="10e-6"/>
            <string name="trajectory" value="path_{number}.csv"/>
            <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
                <string name="filename" value="{letter}.png"/><boolean name="raw" value="true"/>
                <string name="filter_type" value="nearest"/><string name="wrap_mode" value="clamp"/>
            </texture></bsdf>
        </bsdf>
    </shape>
"""


SPOT_M = 1.5e-3
"""Diameter of the laser spot. Its speckle on the objects, with grains of 180 um, stays the same while they move apart."""

MIN_APART_M = 3.5e-6
"""Least difference of the mean displacements of two objects per frame, 1.5 pixels of speckle: objects of equal motion are one object."""


def _speeds(rng: np.random.Generator, objects: int, per_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean velocities of the objects, (n, 2), and their speeds: at most two grains of the speckle per exposure."""
    while True:
        speed = 10.0 ** rng.uniform(-5.0, np.log10(min(2e-2, 3.5e-5 * per_s)), objects)
        angle = rng.uniform(0.0, 2.0 * np.pi, objects)
        velocity = speed[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
        apart = np.linalg.norm(velocity[:, None] - velocity[None], axis=2) + 1e9 * np.eye(objects)
        if objects == 1 or apart.min() > MIN_APART_M * per_s:
            return velocity, speed


def draw(number: int, folder: Path, objects: int, shape: tuple[int, int] = SHAPE) -> tuple[Geometry, dict[str, Any]]:
    """Return a random scene of moving letters on frames of a shape, and what was drawn."""
    rng = np.random.default_rng([4646, number, objects])
    per_s = float(10.0 ** rng.uniform(np.log10(30.0), np.log10(2000.0)))
    photoelectrons = float(10.0 ** rng.uniform(-2.5, -0.5))
    text = scene_path("corner_letter").read_text()
    begin, end = text.index("    <!-- 1 cm square"), text.index("    <!-- the wall that the camera")
    shapes, times = [], np.linspace(0.0, FRAMES / per_s, 4 * FRAMES + 1)
    drawn: dict[str, Any] = {
        "number": number,
        "objects": objects,
        "frames_per_s": per_s,
        "photoelectrons": photoelectrons,
        "speeds": [],
        "letters": [],
    }
    velocities, speeds = _speeds(rng, objects, per_s)
    for one, (velocity, speed) in enumerate(zip(velocities, speeds, strict=True)):
        letter, half = LETTERS[int(rng.integers(len(LETTERS)))], float(rng.uniform(1.5e-3, 2.5e-3)) if objects > 1 else 5e-3
        turn = np.arctan2(velocity[1], velocity[0]) + 0.4 * np.sin(
            2.0 * np.pi * times / times[-1] + rng.uniform(0.0, 2.0 * np.pi)
        )
        steps = speed * np.diff(times, prepend=0.0)[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1)
        way = np.cumsum(steps, 0)
        if rng.random() < 0.3:
            way += np.outer(np.sin(2.0 * np.pi * 0.2 * per_s * times), rng.uniform(-2e-6, 2e-6, 2))
        rows = "\n".join(f"{when:.9g},{x:.9g},{y:.9g},0" for when, (x, y) in zip(times, way, strict=True))
        (folder / f"path_{one}.csv").write_text(f"time_s,x_m,y_m,z_m\n{rows}\n")
        (folder / f"{letter}.png").write_bytes(scene_path("corner_letter").with_name(f"{letter}.png").read_bytes())
        x, y = (
            ((one - 0.5 * (objects - 1)) * 4e-3 + rng.uniform(-5e-4, 5e-4), rng.uniform(-2e-3, 2e-3))
            if objects > 1
            else (0.0, 0.0)
        )
        shapes.append(OBJECT.format(number=one, letter=letter, half=half, x=x, y=y))
        drawn["speeds"].append(float(speed))
        drawn["letters"].append((letter, half))
    text = text[:begin] + "".join(shapes) + text[end:]
    text = text.replace('value="2464"', f'value="{shape[1]}"').replace('value="2056"', f'value="{shape[0]}"')
    spot = '<float name="spot_diameter" value="5e-3"/>'
    assert spot in text
    still = f'<float name="spot_diameter" value="{SPOT_M}"/><float name="scan_step" value="0"/>'
    (folder / "scene.xml").write_text(text.replace(spot, still))
    geometry = cg.load(folder / "scene.xml", exposure=1.0 / per_s).geometry
    light = Simulation(geometry).mean_photoelectrons
    return geometry.with_power(geometry.light_path.power_w * photoelectrons / light), drawn


def true_paths(geometry: Geometry) -> list[np.ndarray]:
    """Return the paths of the objects in metres along rows and columns, (frames, 2) each, from the first frame."""
    times = np.array([geometry.frame_middle_s(number) for number in range(FRAMES)])
    ways = [geometry.hidden_object.axes.coordinates(one.trajectory.displacement(times)) for one in geometry.movements]
    return [way - way[0] for way in ways]


def errors(truths: list[np.ndarray], found: list[np.ndarray]) -> list[float]:
    """Return the rms error of each true path in its unit, by the best assignment; infinity for an object that was not found."""
    while len(found) < len(truths):
        found = [*found, np.full_like(truths[0], np.inf)]

    def rms(truth: np.ndarray, path: np.ndarray) -> float:
        left = path - truth
        return float(np.sqrt(((left - left.mean(0)) ** 2).sum(1).mean())) if np.isfinite(left).all() else float("inf")

    table = np.array([[rms(truth, path) for path in found] for truth in truths])
    best = min(
        permutations(range(len(found)), len(truths)), key=lambda chosen: sorted(table[range(len(truths)), chosen], reverse=True)
    )
    return table[range(len(truths)), best].tolist()


def images(capture: cg.Capture, letters: list[tuple[str, float]], whose: list[int]) -> dict[str, Any]:
    """Return the correlation of the image of each object with its letter, its confidence, and the correlation of what all frames show
    together.

    Args:
        whose: index of the letter of each object that was found.
    """
    truths = []
    for letter, half in letters:
        bitmap, _ = read_image(scene_path("corner_letter").with_name(f"{letter}.png"))
        truths.append(cg.Truth(bitmap, (2.0 * half / bitmap.shape[0], 2.0 * half / bitmap.shape[1])))
    together = cg.reconstruct(capture, mean_model="pooled")
    alone = []
    for number in range(1, 1 + len(whose)):
        try:
            alone.append(cg.reconstruct(capture, object_number=number))
        except cg.InputError:  # the travel is not clear enough for images
            break
    return {
        "image": [one.compare(truths[of]).pearson for one, of in zip(alone, whose, strict=False)],
        "confidence": [one.confidence for one in alone],
        "image_together": [together.compare(truths[of]).pearson for of in whose],
        "confidence_together": together.confidence,
    }


def measure(number: int, options: argparse.Namespace) -> dict[str, Any]:
    """Draw, render and track one scene."""
    from sim.rendering import render_geometry

    with tempfile.TemporaryDirectory() as folder:
        geometry, drawn = draw(number, Path(folder), options.objects, tuple(options.shape))
        capture = render_geometry(geometry, FRAMES, number)
    truths, begin = true_paths(geometry), time.process_time()
    to_metres = np.linalg.inv(geometry.travel)
    try:
        found = cg.track(capture, interval_s=1.0 / drawn["frames_per_s"])
    except cg.InputError as error:
        return drawn | {"refused": str(error)}
    seconds = time.process_time() - begin
    tracks = [found, *found.others]
    told = drawn | {
        "found": len(tracks),
        "significance": [one.significance for one in tracks],
        "rms_um": [
            1e6 * one if np.isfinite(one) else None for one in errors(truths, [one.path_pixels @ to_metres.T for one in tracks])
        ],
        "bound_um": [1e6 * one for one in bounds_m(geometry, capture, truths)],
        "way_um": [1e6 * float(np.linalg.norm(np.diff(one, axis=0), axis=1).sum()) for one in truths],
        "frames_per_position": [one.frames_per_position for one in tracks],
        "cpu_ms_per_frame": 1e3 * seconds / FRAMES,
    }
    if options.images:
        paths = [one.path_pixels @ to_metres.T for one in tracks]
        whose = [int(np.argmin([np.abs(path - truth).max() for truth in truths])) for path in paths]
        told |= images(capture, drawn["letters"], whose)
    return told


def draw_pair(file: Path) -> None:
    """Render the shipped scene of two moving letters; draw a frame, the paths, what all objects show together, and each alone."""
    from matplotlib.figure import Figure

    capture = cg.render(cg.load("moving_pair"), frames=24, seed=3)
    found = cg.track(capture)
    shown = {"all together": cg.reconstruct(capture, mean_model="pooled")}
    shown |= {f"--object {number}": cg.reconstruct(capture, object_number=number) for number in (1, 2)}
    figure = Figure(figsize=(12.5, 2.7), layout="constrained")
    axes = figure.subplots(1, 5)
    axes[0].imshow(capture.frames[0][:200, :200], cmap="gray")
    axes[0].set(title="corner of a frame", xticks=[], yticks=[])
    for number, one in enumerate((found, *found.others), 1):
        axes[1].plot(one.path_pixels[:, 1], one.path_pixels[:, 0], ".-", markersize=4, linewidth=0.8, label=str(number))
    axes[1].set(title="paths of the speckle (pixels)", aspect="equal")
    axes[1].invert_yaxis()
    axes[1].legend(frameon=False)
    for one, (title, result) in zip(axes[2:], shown.items(), strict=True):
        side = len(result.albedo)
        middle = np.s_[side // 4 : 3 * side // 4, side // 4 : 3 * side // 4]
        one.imshow(result.albedo[middle], cmap="gray")
        one.set(title=f"{title}, confidence {result.confidence:.2f}", xticks=[], yticks=[])
    figure.savefig(file, dpi=110)


def frames_per_s(count: int, turn: float) -> dict[str, float]:
    """Return wall and CPU seconds per frame of 5 megapixels in memory, binned by four.

    Args:
        turn: angle in radians per frame by which the field becomes another one; 0 for speckle that stays the same.
    """
    rng = np.random.default_rng(5)
    shape = (2056 + 2 * count, 2464 + count)
    radius = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None])
    one, other = (
        np.fft.ifft2((rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) * (radius < 0.06)).astype(np.complex64)
        for _ in range(2)
    )
    light, frames = 0.05 / float((np.abs(one) ** 2).mean()), []
    for number in range(count):
        seen = np.s_[2 * number : 2 * number + 2056, number : number + 2464]
        field = np.cos(turn * number) * one[seen] + np.sin(turn * number) * other[seen]
        frames.append(rng.poisson(light * np.abs(field) ** 2).astype(np.uint8))
    begin, cpu = time.perf_counter(), time.process_time()
    found = cg.track(cg.Capture(frames), binning=4)
    assert np.abs(np.abs(found.step_pixels) - (2.0, 1.0)).max() < 0.1
    return {"wall_s": (time.perf_counter() - begin) / count, "cpu_s": (time.process_time() - cpu) / count}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--objects", type=int, default=1, help="number of objects (1)")
    parser.add_argument(
        "--shape", type=int, nargs=2, metavar=("ROWS", "COLUMNS"), default=SHAPE, help="pixels of a frame (560 640)"
    )
    parser.add_argument("--images", action="store_true", help="also reconstruct each object")
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--pair", type=Path, metavar="FILE", help="draw the shipped scene of two moving letters instead")
    parser.add_argument("--speed", action="store_true", help="measure the time of a frame of 5 megapixels instead")
    options = parser.parse_args()
    if options.pair:
        draw_pair(options.pair)
        return
    if options.speed:
        for count in (100, 200):
            for turn in (0.0, 0.04):
                print(f"{count} frames, {turn:g} radians per frame:", frames_per_s(count, turn), flush=True)
        return
    rows = []
    for number in range(options.first, options.first + options.count):
        rows.append(measure(number, options))
        print(rows[-1], flush=True)
    found = [
        (one, bound) for row in rows for one, bound in zip(row.get("rms_um", []), row.get("bound_um", []), strict=True) if one
    ]
    if found:
        print(
            f"rms of error over bound, {len(found)} paths: {np.mean([(one / bound) ** 2 for one, bound in found]) ** 0.5:.3g}"
        )
    if options.output:
        save_json(options.output, {"trajectories": rows})


if __name__ == "__main__":
    main()
