"""Highest error of an estimate at which reconstructions of a known object still reach a given correlation."""

from __future__ import annotations

import math
from itertools import count

import numpy as np
import torch

from correlograph.errors import InputError
from invert.albedo.metrics import aligned_pearson
from invert.choices import BALANCED, UNET, Quality
from invert.measure.estimate import Estimate
from invert.pipeline import reconstruct
from invert.solvers.base import Progress, no_progress
from radiometry.noise.budget import estimate_error
from radiometry.noise.model import draw_estimate

STANDARD_ERROR = 0.05
"""Standard error of the natural logarithm of the result at which sampling stops."""

MIN_DRAWS, MAX_DRAWS = 12, 160
"""Number of reconstructions near the result."""

SPREAD = 0.3
"""Errors are sampled this far below and above the present solution, as natural logarithms."""


def required_error(
    albedo: np.ndarray,
    signal: np.ndarray,
    transfer: np.ndarray,
    dof: float,
    correlation: float,
    quality: Quality = BALANCED,
    seed: int = 0,
    progress: Progress = no_progress,
) -> float:
    """Return the relative error of an estimate at which the mean correlation of its reconstructions equals `correlation`.

    Args:
        albedo: the object (n, n), a cell for each lag.
        signal: its r*r as an estimate shows it without noise, (2 n - 1, 2 n - 1), zero lag 1.
        transfer: H of the camera, of the same shape, which `signal` contains.
        dof: K of the estimates.
        progress: called with 1 after each reconstruction.

    Raises InputError for a correlation that noise-free estimates do not reach.
    """
    draws = count(seed)

    def correlation_at(error: float) -> float:
        draw = next(draws)
        rng = torch.Generator().manual_seed(draw)
        spectrum = torch.from_numpy(signal + floor_for(error, signal, dof)).float()
        lags = draw_estimate(spectrum, dof, rng, correlated=True).numpy()
        result = reconstruct(Estimate("drawn", lags, transfer=transfer), method=UNET, quality=quality, seed=draw)
        progress(1)
        return aligned_pearson(result.albedo, albedo)[0]

    lowest = floorless_error(signal, dof)
    error = max(0.5, 1.5 * lowest)
    # The error doubles or halves until the correlation is passed; a straight line through samples near that error is then solved.
    factor = 2.0 if correlation_at(error) > correlation else 0.5
    while True:
        if error * factor <= lowest:
            found = f"{correlation:g}, which needs a smaller error than {lowest:.2g} of these frames without noise"
            raise InputError("--correlation", "one that the reconstruction can reach", found, "lower it or add frames")
        if (correlation_at(error * factor) > correlation) != (factor > 1.0):
            break
        error *= factor
    solution = math.log(error) + 0.5 * math.log(factor)
    tried, reached = [], []
    while len(tried) < MAX_DRAWS:
        for offset in (-SPREAD, SPREAD):
            tried.append(solution + offset)
            reached.append(correlation_at(math.exp(tried[-1])))
        if len(tried) >= MIN_DRAWS:
            solution, uncertainty = _solve(np.array(tried), np.array(reached), correlation)
            if uncertainty < STANDARD_ERROR:
                break
    return math.exp(solution)


def _solve(tried: np.ndarray, reached: np.ndarray, correlation: float) -> tuple[float, float]:
    """Return the logarithm of the error that a straight line through the samples gives `correlation`, and its standard error."""
    (slope, offset), residual, *_ = np.polyfit(tried, reached, 1, full=True)
    slope = min(slope, -0.02)
    deviation = math.sqrt(float(residual[0]) / (len(tried) - 2)) if len(residual) else 0.0
    solution = float(np.clip((correlation - offset) / slope, tried.min() - SPREAD, tried.max() + SPREAD))
    return solution, deviation / abs(slope) / math.sqrt(len(tried))


def floorless_error(signal: np.ndarray, dof: float) -> float:
    """Return the error that the finite number of speckle grains alone causes in an estimate without floor."""
    return estimate_error(float(signal.sum()), float((signal**2).sum()), signal.size, 0.0, dof)


def floor_for(error: float, signal: np.ndarray, dof: float) -> float:
    """Return the floor over peak at which an estimate has `error`; 0 if even an estimate without floor has a larger error."""
    total, square = float(signal.sum()), float((signal**2).sum())
    # error^2 K square = square + 2 floor total + lags floor^2
    missing = error**2 * dof * square - square
    if missing <= 0.0:
        return 0.0
    return (math.sqrt(total**2 + signal.size * missing) - total) / signal.size
