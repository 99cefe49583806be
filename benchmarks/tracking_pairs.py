"""`python -m benchmarks.tracking_pairs`: objects of random shape, whose fields add on small frames, tracked: how many are found, how many
paths belong to none.

Two or three characters, groups of strokes or filled shapes lie beside each other and move at constant velocities of up to a few pixels of
speckle per frame. The fields of their speckle travel, add and interfere on 24 to 63 frames of 260 to 700 pixels a side with 0.5 to 10
photoelectrons per pixel. Nothing fades, so that only the interference makes the search hard. A path belongs to an object if its rms error
is below the width of a grain of the scene, or 1 % of the way. Single objects (`--objects 1`) have grains of up to a tenth of the frame;
the largest deviation from the true path is compared with the stated error.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.fft import fftfreq, ifft2, next_fast_len
from scipy.ndimage import map_coordinates

import correlograph as cg
from benchmarks.tracking import errors
from data_gen.shapes import filled_shape, glyph, strokes

BORDER = 160
"""Pixels of the pattern beyond the frame, which objects may bring into view."""


def draw_object(rng: np.random.Generator) -> np.ndarray:
    """Return the albedo (n, n) of a character, of strokes, or of filled shapes."""
    kind = int(rng.integers(3))
    return glyph(str(rng.choice(list("ABEFGHJKLNRSTUYZ234579"))), rng) if kind == 0 else (strokes, filled_shape)[kind - 1](rng)


def draw_places(rng: np.random.Generator, objects: int) -> np.ndarray:
    """Return the centres and sides (n, 3) of squares beside each other within a square of side one around zero."""
    while True:
        found = np.column_stack([rng.uniform(-0.5, 0.5, (objects, 2)), rng.uniform(0.2, 0.45, objects)])
        inside = (np.abs(found[:, :2]).max(1) + 0.5 * found[:, 2] < 0.5).all()
        away = np.abs(found[:, None, :2] - found[None, :, :2]).max(2) + np.eye(objects)
        if inside and (away > 0.5 * (found[:, None, 2] + found[None, :, 2])).all():
            return found


def frequencies_around(shape: np.ndarray) -> np.ndarray:
    """Return the frequencies (rows, columns, 2) in cycles per pixel of a pattern that is larger than a frame of a shape by a border."""
    sides = [next_fast_len(int(side) + BORDER) for side in shape]
    return np.stack(np.meshgrid(*(fftfreq(side) for side in sides), indexing="ij"), -1)


def albedo_at(albedo: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return an albedo (n, n) at places (..., 2) from -0.5 to 0.5 across it, zero beyond."""
    return map_coordinates(albedo.astype(np.float64), np.moveaxis(places + 0.5, -1, 0) * len(albedo), order=0, mode="constant")


def draw(number: int, objects: int, vibrating: bool = False) -> tuple[list[np.ndarray], np.ndarray, float]:
    """Return the frames of random scene `number`, the velocities of its objects in pixels of speckle per frame, (n, 2), and the width of a
    grain of all of them together. The phase of vibrating objects is new in every frame."""
    rng = np.random.default_rng([number, objects, 4648])
    shape = rng.integers(*((260, 400) if number % 2 else (420, 700)), 2)
    grain, light, count = rng.uniform(2.2, 5.0), 10.0 ** rng.uniform(-0.3, 1.0), int(rng.integers(24, 64))
    frequencies, fields = frequencies_around(shape), []
    sides = frequencies.shape[:2]
    for row, column, side in draw_places(rng, objects):
        albedo = albedo_at(draw_object(rng), (frequencies * grain - (row, column)) / side)
        field = np.sqrt(albedo) * (rng.normal(size=sides) + 1j * rng.normal(size=sides))
        fields.append(field / np.linalg.norm(field) * np.sqrt(rng.uniform(0.35, 1.0)))
    velocities = rng.normal(size=(objects, 2)) * rng.uniform(0.1, 1.2, (objects, 1))
    frames, phases = [], np.random.default_rng(number).random((count, objects)) * vibrating
    for when, turns in zip(np.arange(count) - 0.5 * count, phases, strict=True):
        moved = sum(
            field * np.exp(-2j * np.pi * (when * (frequencies @ one) + turn))
            for field, one, turn in zip(fields, velocities, turns, strict=True)
        )
        frames.append(np.abs(ifft2(moved)[: shape[0], : shape[1]]) ** 2)
    scale = light / np.mean(frames)
    return [rng.poisson(scale * one).astype(np.float32) for one in frames], velocities, float(grain)


def measure(number: int, objects: int, vibrating: bool) -> dict[str, Any]:
    """Draw and track one scene."""
    frames, velocities, grain = draw(number, objects, vibrating)
    row = {"number": number, "shape": frames[0].shape, "frames": len(frames), "velocities": velocities.round(3).tolist()}
    try:
        track = cg.track(cg.Capture(frames))
    except cg.InputError as error:
        return row | {"found": 0, "of_none": 0, "refused": str(error)}
    tracks = [track, *track.others]
    ways = [np.outer(np.arange(len(frames)), one) for one in velocities]
    missed = errors(ways, [one.path_pixels for one in tracks])
    limits = [max(grain, 0.01 * float(np.linalg.norm(way[-1]))) for way in ways]
    found = sum(one < limit for one, limit in zip(missed, limits, strict=True))
    steps = [one.step_pixels.round(3).tolist() for one in tracks]
    nearest = [min((one.path_pixels - way for way in ways), key=lambda away: np.abs(away).max()) for one in tracks]
    return row | {
        "warnings": [one.warnings for one in tracks],
        "largest_deviations_in_errors": [
            float(np.abs(away[1:] / one.error_pixels[1:]).max()) for away, one in zip(nearest, tracks, strict=True)
        ],
        "steps": steps,
        "shares": [round(one.share, 3) for one in tracks],
        "rms_pixels": [one if np.isfinite(one) else None for one in missed],
        "found": found,
        "of_none": len(tracks) - found,
    }


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=int, default=2, help="objects in each scene, 1 to 3 (2)")
    parser.add_argument("--count", type=int, default=40, help="scenes (40)")
    parser.add_argument("--first", type=int, default=0, help="number of the first scene, which sets all random numbers (0)")
    parser.add_argument("--vibrating", action="store_true", help="the phase of each object is new in every frame")
    options, rows = parser.parse_args(argv), []
    for number in range(options.first, options.first + options.count):
        rows.append(measure(number, options.objects, options.vibrating))
        print(json.dumps(rows[-1]), flush=True)
    found, of_none = (sum(row[key] for row in rows) for key in ("found", "of_none"))
    told = [row for row in rows if "refused" not in row]
    for title, is_warned in (("without a warning", False), ("with one", True)):
        worst = sorted(
            one
            for row in told
            for one, warnings in zip(row["largest_deviations_in_errors"], row["warnings"], strict=True)
            if bool(warnings) == is_warned
        )
        print(f"largest deviations of paths {title}, in standard errors: {', '.join(f'{one:.2g}' for one in worst)}")
    print(f"{found} of {options.objects * options.count} objects found, {of_none} paths of none")


if __name__ == "__main__":
    main()
