"""Detection of an object: significance of the signal above the floor of an estimate."""

from __future__ import annotations

import numpy as np

from correlograph.lags import lag_grid_of
from radiometry.noise.measured_noise import NoiseLevel

DETECTION_LIMIT = 6.0
"""Minimum significance of a signal, in standard deviations above the floor; below it, no object is reported."""

TRIALS = 5
"""Number of normal variables whose highest is distributed like the significance of noise (`tests/invert/test_hypotheses.py`)."""

SLOPE_WEIGHT = 1.5
"""Weight of the excess over a sloping background; the signal must exceed that as well, by two thirds of the limit for a
flat floor."""


def detection(estimate: np.ndarray, noise: NoiseLevel) -> float:
    """Return the significance of the signal in standard deviations: the highest of the summed excesses over growing rings.

    It is a matched filter for blobs of unknown size around zero lag; zero lag itself is excluded. The excess is measured from the
    floor or, if that gives less, `SLOPE_WEIGHT` times from a floor a + b r^2 of the lags outside the ring, extrapolated into it.
    """
    grid = lag_grid_of(estimate)
    half, rings = grid.half_plane, grid.ring
    if noise.floor <= 0.0:
        return float("inf") if estimate[half].max() > 0.0 else 0.0
    spread = max(noise.deviation * noise.inflation**0.5, 1e-6 * noise.floor)
    flat, sloping = [], []
    for ring in (ring for ring in (2, 4, 8, 16, 32, 64, 128) if 2 * ring <= grid.object_side):
        inside, outside = half & (ring >= rings), half & (ring < rings)
        count = float(inside.sum())
        flat.append(float((estimate[inside] - noise.floor).sum()) / (spread * count**0.5))
        basis = np.stack([np.ones(int(outside.sum())), rings[outside].astype(np.float64) ** 2], 1)
        total = np.array([count, float((rings[inside].astype(np.float64) ** 2).sum())])
        inverse = np.linalg.inv(basis.T @ basis)
        excess = float(estimate[inside].sum()) - total @ (inverse @ (basis.T @ estimate[outside].astype(np.float64)))
        sloping.append(excess / (spread * (count + total @ inverse @ total) ** 0.5))
    return min(max(flat), SLOPE_WEIGHT * max(sloping))
