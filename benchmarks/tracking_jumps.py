"""`python -m benchmarks.tracking_jumps`: paths of single objects in faint light, with and without a jump, or with sharp turns.

A character, strokes or filled shapes move at 0.5 to 4 pixels of speckle per frame, half of them with a change of velocity at random, on 64
or 128 frames of 200 to 420 pixels a side with 200 to 4000 photoelectrons each. The illumination changes: intensities k frames apart
correlate by exp(-fading k^2) with a fading of 0.0005 to 0.03. In half of the captures, the path jumps once by up to 90 pixels along rows
and columns, as if frames were missing. With `--turns`, frames have 80 to 400 photoelectrons, no path jumps, and velocities take another
direction after 8 to 24 frames each time. A path is right if it is within six stated errors everywhere, but for two frames beside the jump.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.fft import ifft2

import correlograph as cg
from benchmarks.tracking_pairs import albedo_at, draw_object, frequencies_around

MAX_SIGMA = 6.0
"""Stated errors by which a path may deviate from the true one."""

LIGHTS, DIM_LIGHTS = (200.0, 4000.0), (80.0, 400.0)
"""Least and largest number of photoelectrons in a frame, with jumps and with turns."""

LEGS = (8, 24)
"""Least and largest number of frames between two turns."""

BESIDE_JUMP = 2
"""Frames before and after a jump that may lie on its other side."""


def draw_turns(count: int, speed: float, rng: np.random.Generator) -> np.ndarray:
    """Return steps (count, 2) of a speed in a direction that lasts for some frames each time."""
    steps = np.zeros((0, 2))
    while len(steps) < count:
        angle, frames = rng.uniform(0.0, 2.0 * np.pi), int(rng.integers(*LEGS, endpoint=True))
        steps = np.concatenate([steps, np.full((frames, 2), speed * np.array([np.sin(angle), np.cos(angle)]))])
    return steps[:count]


def draw(number: int, turns: bool = False) -> tuple[list[np.ndarray], np.ndarray, int | None, dict[str, Any]]:
    """Return the frames of random capture `number`, the path of its speckle, (frames, 2), the frame before which it jumps, if it does, and
    what was drawn."""
    rng = np.random.default_rng([number, 4649])
    count, shape = int(rng.choice([64, 128])), rng.integers(200, 420, 2)
    lights = DIM_LIGHTS if turns else LIGHTS
    photoelectrons, fading = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (lights, (5e-4, 0.03)))
    angle, speed, grain = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.5, 4.0), rng.uniform(4.0, 8.0)
    steps = speed * np.array([np.sin(angle), np.cos(angle)]) * np.ones((count - 1, 2))
    steps += rng.choice([0.0, 0.05]) * np.cumsum(rng.normal(size=steps.shape), 0)
    jump = int(rng.integers(count // 4, 3 * count // 4)) if rng.random() < 0.5 else None
    if turns:
        jump, steps = None, draw_turns(count - 1, speed, rng)
    if jump is not None:
        steps[jump - 1] += rng.uniform(-90.0, 90.0, 2)
    path, numbers = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)]), np.arange(count)

    frequencies = frequencies_around(shape)
    albedo = albedo_at(draw_object(rng), frequencies * grain)
    lit = albedo > 0.0
    values, vectors = np.linalg.eigh(np.exp(-0.5 * fading * (numbers[:, None] - numbers) ** 2))
    fresh = rng.normal(size=(count, lit.sum())) + 1j * rng.normal(size=(count, lit.sum()))
    illumination = (vectors * np.sqrt(np.maximum(values, 0.0))) @ fresh

    frames, field = [], np.zeros(albedo.shape, complex)
    for light, place in zip(illumination, path, strict=True):
        field[lit] = np.sqrt(albedo[lit]) * light * np.exp(-2j * np.pi * (frequencies[lit] @ place))
        frames.append(np.abs(ifft2(field)[: shape[0], : shape[1]]) ** 2)
    scale = photoelectrons / (np.mean(frames) * shape.prod())
    drawn = {"number": number, "frames": count, "photoelectrons": photoelectrons, "fading": fading, "jump": jump}
    return [rng.poisson(scale * one).astype(np.float32) for one in frames], path, jump, drawn


def measure(number: int, turns: bool = False) -> dict[str, Any]:
    """Draw and track one capture."""
    frames, path, jump, row = draw(number, turns)
    try:
        track = cg.track(cg.Capture(frames))
    except cg.InputError as error:
        return row | {"result": "refused", "error": str(error)}
    beside = [] if jump is None else range(jump - BESIDE_JUMP, jump + BESIDE_JUMP)
    deviation = np.linalg.norm(track.path_pixels - path, axis=1)[1:] / np.linalg.norm(track.error_pixels, axis=1)[1:]
    largest = float(np.delete(deviation, [one - 1 for one in beside]).max())
    right = largest < MAX_SIGMA and not track.others
    return row | {"result": "right" if right else "wrong", "largest_deviation_in_errors": largest, "warnings": track.warnings}


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100, help="captures (100)")
    parser.add_argument("--first", type=int, default=0, help="number of the first capture, which sets all random numbers (0)")
    parser.add_argument("--turns", action="store_true", help="sharp turns instead of jumps")
    options, rows = parser.parse_args(argv), []
    for number in range(options.first, options.first + options.count):
        rows.append(measure(number, options.turns))
        print(json.dumps(rows[-1]), flush=True)
    for kind, chosen in (
        ("without a jump", [one for one in rows if one["jump"] is None]),
        ("with a jump", [one for one in rows if one["jump"]]),
    ):
        results = Counter(one["result"] for one in chosen)
        if chosen:
            print(
                f"{len(chosen)} paths {kind}: " + ", ".join(f"{results[name]} {name}" for name in ("right", "wrong", "refused"))
            )


if __name__ == "__main__":
    main()
