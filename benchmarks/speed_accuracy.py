"""`python -m benchmarks.speed_accuracy [-o docs/figures]`: every kernel against the direct sum in float64.

Sweeps standoff 0.05 to 100 m, depth 0 to 20 mm and tilt 0 to 60 degrees, and, at 1 m, frames of half and twice the size; the
object is 1 cm across, or a third of the field of view where that is smaller, and depth shrinks with it. Writes
speed_accuracy.json, a table and the Pareto picture.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import sim  # noqa: F401 - sets the Mitsuba variant, and with it Dr.Jit's backend
from sim.propagation.choose import choose, options
from sim.propagation.kernels import KERNELS
from sim.propagation.option import Option, Task, Terms
from sim.propagation.sampling import Lattice, Scatterers, Wall

WAVELENGTH_M, PIXEL_M, SHAPE = 532e-9, 6.9e-6, (257, 308)
STANDOFFS_M = (0.05, 0.2, 0.5, 1.0, 3.0, 10.0, 100.0)
DEPTHS_M = (0.0, 2e-3, 2e-2)
TILTS_DEG = (0.0, 20.0, 60.0)
OTHER_SHAPES = ((129, 154), (514, 616))
TILES = 8
"""Fraction of the frame side over which the expected autocorrelation is averaged."""

TOLERANCES = {"statistical": (1e-2, 1e-3), "field": (1e-2, 1e-3, 1e-4, 1e-6)}


@dataclass(frozen=True)
class Object:
    """A rough, tilted, stepped plate sampled at the lag pitch of the whole frame."""

    scatterers: Scatterers
    wall: Wall

    @property
    def place(self) -> np.ndarray:
        """Return the positions at which FFT propagators place the scatterers."""
        return np.stack([self.scatterers.position_m @ self.wall.down, self.scatterers.position_m @ self.wall.right], 1)


def make_object(standoff_m: float, depth_m: float, tilt_deg: float, seed: int = 0, shape: tuple[int, int] = SHAPE) -> Object:
    rng = np.random.default_rng(seed)
    pitch = [WAVELENGTH_M * standoff_m / (PIXEL_M * n) for n in shape]
    size = min(0.01, 0.33 * WAVELENGTH_M * standoff_m / PIXEL_M)
    across = size * np.cos(np.deg2rad(tilt_deg))
    grid = (max(2, round(size / pitch[0])), max(2, round(across / pitch[1])))
    row, column = np.nonzero(rng.random(grid) < 0.3)
    y, x = ((index - 0.5 * (n - 1)) * step for index, n, step in zip((row, column), grid, pitch, strict=True))
    depth = np.tan(np.deg2rad(tilt_deg)) * x + depth_m * size / 0.01 * (rng.integers(0, 5, len(x)) / 4.0 - 0.5)
    waves = rng.standard_normal(len(x)) + 1j * rng.standard_normal(len(x))
    wall = Wall(standoff_m * np.eye(3)[2], np.eye(3)[0], np.eye(3)[1], shape, PIXEL_M, WAVELENGTH_M)
    return Object(Scatterers(np.stack([x, y, depth], 1), waves, Lattice((row, column), grid, shape)), wall)


def propagate(option: Option, thing: Object) -> np.ndarray:
    terms = Terms(option.precision, patches=option.patches)
    return KERNELS[option.propagator].propagate(thing.scatterers, thing.wall, terms).numpy()


def field_distance(field: np.ndarray, reference: np.ndarray) -> float:
    """Relative L2 distance after the best global phase is removed."""
    overlap = np.vdot(field, reference)
    return float(np.linalg.norm(field * (overlap / abs(overlap)) - reference) / np.linalg.norm(reference))


def expected_lags(thing: Object, lag_m: float, *, exact: bool) -> np.ndarray:
    """Expected autocorrelation by brute force over tiles: with each tile's fringe frequencies as in an FFT propagator or
    from finite differences of the exact paths.
    """
    from sim.propagation.sampling import path_difference

    total, wall = 0.0, thing.wall
    power = np.abs(thing.scatterers.amplitude) ** 2
    for row in np.linspace(0.0, 1.0, TILES if exact else 1) * (wall.shape[0] - 1):
        for column in np.linspace(0.0, 1.0, TILES if exact else 1) * (wall.shape[1] - 1):
            place = thing.scatterers.position_m[:, 1::-1]
            if exact:
                ends = [wall.pixels(np.array(row + a), np.array(column + b)) for a, b in ((-4, 0), (4, 0), (0, -4), (0, 4))]
                paths = [path_difference(end, thing.scatterers.position_m) for end in ends]
                slope = wall.distance_m / (8.0 * wall.pitch_m)
                place = -slope * np.stack([paths[1] - paths[0], paths[3] - paths[2]], 1)
            image = _shared_out(2.0 * (place / lag_m + 64.0), power)
            total = total + np.abs(np.fft.rfft2(image, s=(512, 512))) ** 2
    row, column = np.fft.fftfreq(512)[:, None], np.fft.rfftfreq(512)
    return np.fft.irfft2(total * np.sinc(2 * row) ** 2 * np.sinc(2 * column) ** 2)  # as a lag cell sees it


def _shared_out(place: np.ndarray, power: np.ndarray, side: int = 256) -> np.ndarray:
    """Put the power of positions (n, 2) on a grid, split linearly among the four nearest cells, so that it does not jump at
    a cell's edge.
    """
    whole = np.clip(np.floor(place).astype(int), 0, side - 2)
    rest = place - whole
    image = np.zeros(side * side)
    for down in (0, 1):
        for right in (0, 1):
            share = np.abs(1 - down - rest[:, 0]) * np.abs(1 - right - rest[:, 1])
            image += np.bincount((whole[:, 0] + down) * side + whole[:, 1] + right, power * share, side * side)
    return image.reshape(side, side)


def scenes() -> list[tuple[float, float, float, tuple[int, int]]]:
    """Standoff, depth, tilt and frame of each scene."""
    bodies = [(depth, tilt) for depth in DEPTHS_M for tilt in TILTS_DEG]
    return [
        *((standoff, *body, SHAPE) for standoff in STANDOFFS_M for body in bodies),
        *((1.0, *body, shape) for shape in OTHER_SHAPES for body in bodies),
    ]


def measure(standoff_m: float, depth_m: float, tilt_deg: float, shape: tuple[int, int]) -> dict[str, Any]:
    """Predicted and measured error and time of every kernel, and what `auto` chose at each tolerance."""
    thing = make_object(standoff_m, depth_m, tilt_deg, shape=shape)
    reference = KERNELS["direct"].propagate(thing.scatterers, thing.wall, Terms("float64")).numpy()
    lag_m = WAVELENGTH_M * standoff_m / (min(SHAPE[0], shape[0]) * PIXEL_M)
    exact_lags = expected_lags(thing, lag_m, exact=True)
    statistical = statistical_distance(expected_lags(thing, lag_m, exact=False), exact_lags)
    kernels, chosen = [], []
    fields: dict[tuple, tuple[np.ndarray, float]] = {}
    for accuracy, tolerances in TOLERANCES.items():
        for tolerance in tolerances:
            listed = options(Task(thing.wall, thing.place, thing.scatterers, lag_m, accuracy, tolerance))
            measured = []
            for option in listed:
                key = (option.propagator, option.precision, option.predicted_error)
                if np.isfinite(option.seconds):
                    if key not in fields:
                        fields[key] = _time_propagation(option, thing)
                    field, seconds = fields[key]
                    error = field_distance(field, reference)
                    if accuracy == "statistical" and KERNELS[option.propagator].on_lattice:
                        error = statistical
                    measured.append((option, error, seconds))
            kernels += [
                {"accuracy": accuracy, **option.as_dict(), "error": error, "measured_seconds": seconds}
                for option, error, seconds in measured
            ]
            auto = choose(listed, "auto", tolerance)
            error, seconds = next((error, seconds) for option, error, seconds in measured if option is auto)
            cheapest = min(seconds for _, error, seconds in measured if error <= tolerance)
            chosen.append(
                {
                    "accuracy": accuracy,
                    "tolerance": tolerance,
                    "propagator": auto.propagator,
                    "precision": auto.precision,
                    "error": error,
                    "seconds": seconds,
                    "cheapest_seconds": cheapest,
                }
            )
    return {
        "standoff_m": standoff_m,
        "depth_m": depth_m,
        "tilt_deg": tilt_deg,
        "frame": shape,
        "scatterers": len(thing.scatterers),
        "kernels": kernels,
        "auto": chosen,
    }


def _time_propagation(option: Option, thing: Object) -> tuple[np.ndarray, float]:
    """The field of a kernel, and the shortest time of three runs (the first compiles and plans)."""
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        field = propagate(option, thing)
        times.append(time.perf_counter() - begin)
    return field, min(times)


def statistical_distance(lags: np.ndarray, exact: np.ndarray) -> float:
    """Relative L2 distance of two expected autocorrelations after the best common factor is removed."""
    return float(np.linalg.norm(lags * ((lags * exact).sum() / (lags * lags).sum()) - exact) / np.linalg.norm(exact))


def whole_frame() -> str:
    """Return the time of a reference-scene frame with photon noise relative to one FFT plus one Poisson draw, and the rate
    of the direct sum.
    """
    import torch

    from scenes import scene_path
    from sim.frame import Simulation
    from sim.scene_file import load_scene
    from sim.scene_reader import read_geometry

    simulation = Simulation(read_geometry(load_scene(scene_path("corner_letter"))[0]))
    noise, wave = np.random.default_rng(0), torch.randn(*simulation.geometry.camera.frame_shape, dtype=torch.complex64)
    mean = simulation.expected_frame(0, 0).numpy()

    def fastest(run: Any) -> float:
        times = []
        for _ in range(5):
            begin = time.perf_counter()
            run()
            times.append(time.perf_counter() - begin)
        return min(times)

    frame, fft = fastest(lambda: simulation.frame(0, 0)), fastest(lambda: torch.fft.fft2(wave))
    poisson = fastest(lambda: noise.poisson(mean))
    thing = make_object(1.0, 0.0, 0.0)
    wall = replace(thing.wall, shape=simulation.geometry.camera.frame_shape)
    pairs = len(thing.scatterers) * np.prod(wall.shape)
    direct = KERNELS["direct"].propagate
    rate = {
        precision: pairs / fastest(lambda terms=terms: direct(thing.scatterers, wall, terms)) / 1e9
        for precision, terms in (("float32", Terms("float32")), ("float64", Terms("float64")))
    }
    return (
        f"whole frame, fraunhofer with photon noise: {frame:.3f} s, {frame / (fft + poisson):.2f} times one complex64 FFT "
        f"({fft:.3f} s) and one Poisson draw ({poisson:.3f} s); direct: {rate['float32']:.2f}e9 pairs/s in float32, "
        f"{rate['float64']:.2f}e9 in float64"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/figures"))
    output = parser.parse_args().output
    from tqdm import tqdm

    results = [measure(*scene) for scene in tqdm(scenes(), unit="scene")]
    (output / "speed_accuracy.json").write_text(json.dumps(results, indent=1, allow_nan=False) + "\n")
    print(whole_frame())
    _report(results)
    _draw(results, output / "speed_accuracy.png")


def _report(results: list[dict[str, Any]]) -> None:
    auto = [choice for result in results for choice in result["auto"]]
    exceeded = [choice for choice in auto if choice["error"] > choice["tolerance"]]
    slow = np.array([choice["seconds"] / choice["cheapest_seconds"] for choice in auto])
    print(
        f"auto: {len(auto)} choices, {len(exceeded)} above their tolerance; time over the cheapest that meets it: median "
        f"{np.median(slow):.2f}, {(slow > 2.0).sum()} above 2, largest {slow.max():.2f}"
    )
    print("| accuracy, kernel | precision | largest error | predicted over measured (where 1e-6 to 1) | seconds, median |")
    print("|---|---|---|---|---|")
    kernels = [
        ((kernel["accuracy"], kernel["propagator"], kernel["precision"]), kernel)
        for result in results
        for kernel in result["kernels"]
        if not _is_reference(kernel) and (kernel["accuracy"] == "field" or kernel["propagator"] == "fraunhofer")
    ]
    for key in dict.fromkeys(key for key, _ in kernels):
        rows = [kernel for own, kernel in kernels if own == key]
        ratios = [row["predicted_error"] / row["error"] for row in rows if 1e-6 < row["error"] < 1.0]
        span = f"{min(ratios):.2f} to {max(ratios):.2f}" if ratios else "none there"
        print(
            f"| {key[0]}, {key[1]} | {key[2]} | {max(row['error'] for row in rows):.2g} | {span} | "
            f"{np.median([row['measured_seconds'] for row in rows]):.3g} |"
        )


def _is_reference(kernel: dict[str, Any]) -> bool:
    return (kernel["propagator"], kernel["precision"]) == ("direct", "float64")


def _draw(results: list[dict[str, Any]], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.add_subplot()
    field = [
        kernel
        for result in results
        if tuple(result["frame"]) == SHAPE
        for kernel in result["kernels"]
        if kernel["accuracy"] == "field" and not _is_reference(kernel)
    ]
    for name, precision in sorted({(kernel["propagator"], kernel["precision"]) for kernel in field}):
        rows = [kernel for kernel in field if (kernel["propagator"], kernel["precision"]) == (name, precision)]
        axes.loglog([row["measured_seconds"] for row in rows], [row["error"] for row in rows], ".", label=f"{name} {precision}")
    axes.set_xlabel(f"seconds, {SHAPE[0]} x {SHAPE[1]} pixels, two cores")
    axes.set_ylabel("relative L2 field error against direct float64")
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
