"""Error of an estimate at which the reconstruction of a known object reaches a correlation."""

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

DRAWS = 8
"""Estimates for each error."""

FACTORS = (0.75, 1.0, 1.33)
"""Errors of the last step, in units of the one before; the result is interpolated between them."""


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
    """Return the relative error of an estimate at which the mean correlation of reconstructions has a value.

    Args:
        albedo: the object (n, n), a cell for each lag.
        signal: its r*r as an estimate shows it without noise, (2 n - 1, 2 n - 1), zero lag 1.
        transfer: H of the camera, of the same shape, which `signal` contains.
        dof: K of the estimates.
        progress: called with 1 after each reconstruction.

    Raises InputError for a correlation that noise-free estimates do not reach.
    """
    draws = count(seed)

    def mean_correlation(error: float, number: int) -> float:
        floor = floor_for(error, signal, dof)
        scores = []
        for draw in (next(draws) for _ in range(number)):
            rng = torch.Generator().manual_seed(draw)
            lags = draw_estimate(torch.from_numpy(signal + floor).float(), dof, rng, correlated=True)
            result = reconstruct(Estimate("drawn", lags.numpy(), transfer=transfer), method=UNET, quality=quality, seed=draw)
            scores.append(aligned_pearson(result.albedo, albedo)[0])
            progress(1)
        return float(np.mean(scores))

    lowest = floorless_error(signal, dof)
    error = max(0.5, 1.5 * lowest)
    # Errors in octaves downwards or upwards until the correlation is passed; then three errors around it.
    step = 2.0 if mean_correlation(error, DRAWS // 4) > correlation else 0.5
    while (mean_correlation(error * step, DRAWS // 4) > correlation) == (step > 1.0):
        error *= step
        if error * step < lowest:
            found = f"{correlation:g}, which needs a smaller error than {lowest:.2g} of these frames without noise"
            raise InputError("--correlation", "one that the reconstruction can reach", found, "lower it or add frames")
    error *= math.sqrt(step)
    tried = [error * factor for factor in FACTORS]
    reached = [mean_correlation(one, DRAWS) for one in tried]
    slope, offset = np.polyfit(np.log(tried), reached, 1)
    return float(np.exp(np.clip((correlation - offset) / min(slope, -1e-3), np.log(tried[0]) - 0.4, np.log(tried[-1]) + 0.4)))


def floorless_error(signal: np.ndarray, dof: float) -> float:
    """Return the error of an estimate without floor, by the finite number of speckle grains alone."""
    return estimate_error(float(signal.sum()), float((signal**2).sum()), signal.size, 0.0, dof)


def floor_for(error: float, signal: np.ndarray, dof: float) -> float:
    """Return the floor over peak at which an estimate has an error; 0 for errors that frames without a floor exceed."""
    total, square = float(signal.sum()), float((signal**2).sum())
    # error^2 K square = square + 2 floor total + lags floor^2
    missing = error**2 * dof * square - square
    if missing <= 0.0:
        return 0.0
    return (math.sqrt(total**2 + signal.size * missing) - total) / signal.size
