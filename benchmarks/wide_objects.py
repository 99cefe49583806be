"""`python -m benchmarks.wide_objects PHOTOGRAPHS [--count 2000] [--seed 0] [--unusual]`: probability of an object wider than the lags.

Objects are letters, characters, edges and grey shapes, or the sixteen unusual kinds, 8 to 256 lags wide (log-uniform), at floors of 0.01
to 100 times the peak of r*r and with 10 to 3000 degrees of freedom. The table compares the probability, computed with the share of wide
objects among all as the probability before, with the share of wide objects among those of similar probability.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from skimage.transform import resize
from tqdm import tqdm

from benchmarks.false_alarms import draw_albedo
from correlograph.lags import LAGS, OBJECT_SIDE
from invert.assess.hypotheses import wide_probability
from invert.evaluation.unusual import KINDS, draw_unusual
from invert.measure.spectrum import Measurement, read_measurement
from radiometry.autocorrelation import autocorrelate, window_kernel
from radiometry.noise.model import draw_estimate

SIDE = 256
"""Maximum width of an object, in lags."""

BOUNDS = (0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0)
"""Bounds of the probabilities in the rows of the table."""


def draw_object(photographs: Path, is_unusual: bool, rng: np.random.Generator) -> np.ndarray:
    """Return the albedo of an object of random width, (256, 256)."""
    drawn = draw_unusual(KINDS[rng.integers(len(KINDS))], rng) if is_unusual else draw_albedo(photographs, rng)[1]
    rows, columns = (np.flatnonzero((drawn > 0.02).any(axis)) for axis in (1, 0))
    drawn = drawn[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    scale = 8.0 * 32.0 ** rng.random() / max(drawn.shape)
    shape = [max(1, round(side * scale)) for side in drawn.shape]
    scaled = resize(drawn.astype(np.float64), shape, order=1, anti_aliasing=scale < 1.0)[:SIDE, :SIDE]
    return np.pad(scaled, [(0, SIDE - side) for side in scaled.shape])


def measure(albedo: np.ndarray, rng: np.random.Generator) -> Measurement:
    """Return a noisy measurement of 127 x 127 lags of an albedo (256, 256)."""
    kernel, middle = window_kernel(SIDE - 1), slice(SIDE - 1 - LAGS, SIDE + LAGS)
    signal = (kernel @ autocorrelate(albedo) @ kernel.T)[middle, middle]
    signal = 0.5 * (signal + signal[::-1, ::-1])
    floor, dof = signal.max() * 10.0 ** rng.uniform(-2.0, 2.0), 10.0 ** rng.uniform(1.0, 3.5)
    noise = torch.Generator().manual_seed(int(rng.integers(2**31)))
    return read_measurement(draw_estimate(torch.from_numpy(signal + floor), dof, noise, correlated=True).numpy())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photographs", type=Path)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--unusual", action="store_true", help="objects of the sixteen unusual kinds")
    options = parser.parse_args()
    measured, widths = [], []
    for number in tqdm(range(options.count), unit="object", disable=None):
        rng = np.random.default_rng([options.seed, number])
        albedo = draw_object(options.photographs, options.unusual, rng)
        measurement = measure(albedo, rng)
        if measurement.detectable:
            measured.append(measurement)
            widths.append(max(np.ptp(np.flatnonzero((albedo > 0.02).any(axis))) + 1 for axis in (0, 1)))
    is_wide = np.array(widths) > OBJECT_SIDE
    share = (is_wide.sum() + 1.0) / (len(is_wide) + 2.0)  # Laplace: never 0 or 1
    found = np.array([wide_probability(one, share) for one in measured])
    print(f"{len(found)} of {options.count} objects detected, {100.0 * share:.0f} % of these wider than {OBJECT_SIDE} lags")
    print("| probability, mean | objects | wide |\n|---|---|---|")
    for low, high in pairwise(BOUNDS):
        if (those := (found >= low) & (found < high + (high == 1.0))).any():
            print(f"| {found[those].mean():.2f} | {those.sum()} | {is_wide[those].mean():.2f} |")


if __name__ == "__main__":
    main()
