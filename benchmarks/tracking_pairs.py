"""`python -m benchmarks.tracking_pairs`: objects of random shape, whose fields add on small frames, tracked: how many are found, how many
paths belong to none.

Two or three letters, strokes or groups of discs lie beside each other and move at constant velocities of up to a few pixels of speckle per
frame. The fields of their speckle travel, add and interfere on 24 to 63 frames of 260 to 700 pixels a side with 0.5 to 10 photoelectrons
per pixel. Nothing fades, so that only the interference makes the search hard. A path belongs to an object if it ends within three widths
of a grain of the true one, or within 3 % of the way.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.fft import fftfreq, ifft2, next_fast_len

import correlograph as cg
from benchmarks.tracking import LETTERS
from correlograph.files.images import read_image
from scenes import scene_path

CELLS = 128
"""Cells on a side of an object."""

MARGIN = 160
"""Pixels of the pattern beyond the frame, which objects may bring into view."""


def draw_object(rng: np.random.Generator) -> np.ndarray:
    """Return the albedo (`CELLS`, `CELLS`) of a letter, of strokes, or of discs."""
    kind, count = int(rng.integers(3)), int(rng.integers(2, 6))
    if kind == 0:
        image, _ = read_image(scene_path("corner_letter").with_name(f"{rng.choice(LETTERS)}.png"))
        places = (np.arange(CELLS) * np.array(image.shape)[:, None] // CELLS).astype(int)
        return (image[np.ix_(*places)] > 0.5).astype(np.float64)
    points = np.stack(np.meshgrid(*2 * [np.linspace(0.0, 1.0, CELLS)], indexing="ij"), -1)
    albedo = np.zeros((CELLS, CELLS))
    for _ in range(count):
        start, end = rng.uniform(0.15, 0.85, (2, 2))
        way = end - start if kind == 1 else np.zeros(2)
        along = np.clip((points - start) @ way / max(way @ way, 1e-9), 0.0, 1.0)
        albedo[np.linalg.norm(points - start - along[..., None] * way, axis=-1) < rng.uniform(0.05, 0.15)] = 1.0
    return albedo


def draw_places(rng: np.random.Generator, objects: int) -> np.ndarray:
    """Return the centres and sides (n, 3) of squares beside each other within a square of side one around zero."""
    while True:
        found = np.column_stack([rng.uniform(-0.5, 0.5, (objects, 2)), rng.uniform(0.2, 0.45, objects)])
        inside = (np.abs(found[:, :2]).max(1) + 0.5 * found[:, 2] < 0.5).all()
        away = np.abs(found[:, None, :2] - found[None, :, :2]).max(2) + np.eye(objects)
        if inside and (away > 0.5 * (found[:, None, 2] + found[None, :, 2])).all():
            return found


def draw(number: int, objects: int) -> tuple[list[np.ndarray], np.ndarray, float]:
    """Return the frames of random scene `number`, the velocities of its objects in pixels of speckle per frame, (n, 2), and the width of a
    grain of all of them together."""
    rng = np.random.default_rng([number, objects, 4648])
    shape = rng.integers(*((260, 400) if number % 2 else (420, 700)), 2)
    grain, light, count = rng.uniform(2.2, 5.0), 10.0 ** rng.uniform(-0.3, 1.0), int(rng.integers(24, 64))
    sides = [next_fast_len(int(side) + MARGIN) for side in shape]
    frequencies = np.stack(np.meshgrid(*(fftfreq(side) for side in sides), indexing="ij"), -1)
    fields = []
    for row, column, side in draw_places(rng, objects):
        places = np.round(((frequencies * grain - (row, column)) / side + 0.5) * CELLS).astype(int)
        albedo = draw_object(rng)[tuple(np.clip(np.moveaxis(places, -1, 0), 0, CELLS - 1))]
        albedo = np.where(((places >= 0) & (places < CELLS)).all(-1), albedo, 0.0)
        field = np.sqrt(albedo) * (rng.normal(size=sides) + 1j * rng.normal(size=sides))
        fields.append(field / np.linalg.norm(field) * np.sqrt(rng.uniform(0.35, 1.0)))
    velocities = rng.normal(size=(objects, 2)) * rng.uniform(0.1, 1.2, (objects, 1))
    frames = []
    for when in np.arange(count) - 0.5 * count:
        moved = sum(
            field * np.exp(-2j * np.pi * when * (frequencies @ one)) for field, one in zip(fields, velocities, strict=True)
        )
        frames.append(np.abs(ifft2(moved)[: shape[0], : shape[1]]) ** 2)
    scale = light / np.mean(frames)
    return [rng.poisson(scale * one).astype(np.float32) for one in frames], velocities, float(grain)


def measure(number: int, objects: int) -> dict[str, Any]:
    """Draw and track one scene."""
    frames, velocities, grain = draw(number, objects)
    row = {"number": number, "shape": frames[0].shape, "frames": len(frames), "velocities": velocities.round(3).tolist()}
    try:
        track = cg.track(cg.Capture(frames))
    except cg.InputError as error:
        return row | {"found": 0, "of_none": 0, "refused": str(error)}
    ways, left, of_none = velocities * (len(frames) - 1), list(range(objects)), 0
    for one in (track, *track.others):
        away = [np.linalg.norm(one.path_pixels[-1] - ways[number]) for number in left]
        near = [
            number
            for distance, number in zip(away, left, strict=True)
            if distance < max(3.0 * grain, 0.03 * np.linalg.norm(ways[number]))
        ]
        if near:
            left.remove(near[0])
        else:
            of_none += 1
    steps = [one.step_pixels.round(3).tolist() for one in (track, *track.others)]
    return row | {"steps": steps, "found": objects - len(left), "of_none": of_none}


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=int, default=2, help="objects in each scene (2)")
    parser.add_argument("--count", type=int, default=40, help="scenes (40)")
    parser.add_argument("--first", type=int, default=0, help="number of the first scene, which sets all random numbers (0)")
    options, rows = parser.parse_args(argv), []
    for number in range(options.first, options.first + options.count):
        rows.append(measure(number, options.objects))
        print(json.dumps(rows[-1]), flush=True)
    found, of_none = (sum(row[key] for row in rows) for key in ("found", "of_none"))
    print(f"{found} of {options.objects * options.count} objects found, {of_none} paths of none")


if __name__ == "__main__":
    main()
