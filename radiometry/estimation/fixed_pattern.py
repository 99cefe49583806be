"""Static background patterns under speckle that changes between frames, and camera shift between frames.

The texture of the relay wall, fringes and the sensor's own pattern are static. They appear as power that the frames share.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.ndimage import binary_dilation, uniform_filter
from scipy.stats import norm

from correlograph.lags import lag_grid_of

FIXED_PATTERN_SIGMA = 4.5
"""Minimum significance, in standard deviations, of shared power that counts as a static pattern."""

MIN_RELATIVE_POWER = 1e-3
"""Least power of a lag over the highest one at which it counts in sums over lags. Below, the edges of the frames let light of bright lags
in, the same to all lags, so that a sum over them varies far more than one over independent lags."""

_BLOCK = 5
_BLOCK_DEVIATION = 0.262
"""Standard deviation of the mean of 5 x 5 lags in units of that of one lag: (1 + 2 sum (1 - n / 5) rho_n) / 5 with rho_n
= 0.152 / n^2."""

_SUM_DEVIATION = 1.5
"""Standard deviation of the sum of many lags in units of that of independent lags: 1 + 2 sum rho_n."""

_MAX_SHIFT_PIXELS = 32
"""Maximum shift of the camera that is searched; an eighth of the frame if that is less."""

SHIFT_FALSE_ALARMS = 1e-4
"""Probability that any frame of a capture, however long, appears shifted from the first one if all are independent."""


def shared_lags(shared: np.ndarray, power: np.ndarray, dof: float) -> np.ndarray:
    """Return a mask of the lags at which the frames have significant common power, tested for single lags, for blocks of
    lags, and for discs around zero lag; bool (127, 127).

    Args:
        shared: real part of the cross-spectrum of the frames. power: their power spectrum in the same unit.
        dof: K of `shared`, whose variance is power^2 / K without a static pattern.
    """
    sigma = np.divide(shared * math.sqrt(dof), power, out=np.zeros_like(shared), where=power > 0.0)
    grid = lag_grid_of(power)
    sigma[grid.lags, grid.lags] = 0.0
    chosen = binary_dilation(sigma > FIXED_PATTERN_SIGMA, np.ones((3, 3), bool))
    summed = power > MIN_RELATIVE_POWER * power[grid.ring > 1].max()
    sigma[~summed] = 0.0
    chosen |= binary_dilation(
        uniform_filter(sigma, _BLOCK, mode="nearest") > FIXED_PATTERN_SIGMA * _BLOCK_DEVIATION, np.ones((3, 3), bool)
    )
    for ring in (*(ring for ring in (2, 4, 8, 16, 32, 64, 128) if ring < grid.lags), grid.lags):
        inside = ring >= grid.ring
        # both signs of a lag hold the same value
        if sigma[inside].sum() > FIXED_PATTERN_SIGMA * _SUM_DEVIATION * math.sqrt(2.0 * (inside & summed).sum()):
            chosen |= inside
    return chosen


def shift_between(first: torch.Tensor, other: torch.Tensor, shape: tuple[int, int], number: int = 1) -> tuple[float, float]:
    """Return the shift (rows, columns) of the shared pattern from one frame to another in pixels, with subpixel precision.

    The shift is zero unless the peak of the cross-correlation exceeds the level that independent frames reach with a
    probability of 6 / (pi number)^2 times `SHIFT_FALSE_ALARMS`; over all frames, the probabilities sum to this constant. The
    variance and the skewness of the cross-correlation of independent frames are measured at shifts beyond the largest one
    that is searched.

    Args:
        first, other: spectra of the frames (rows, columns // 2 + 1) on a grid of `shape`.
        number: number of the other frame in the capture, from 1.
    """
    cross = torch.fft.irfft2(first.conj() * other, s=shape)
    reach = min(_MAX_SHIFT_PIXELS, min(shape) // 8)
    around = (
        torch.roll(cross, (2 * reach, 2 * reach), (0, 1))[: 4 * reach + 1, : 4 * reach + 1].cpu().numpy().astype(np.float64)
    )
    near = around[reach : 3 * reach + 1, reach : 3 * reach + 1]
    beyond = np.ones(around.shape, bool)
    beyond[reach : 3 * reach + 1, reach : 3 * reach + 1] = False
    level = float(around[beyond].mean())
    apart = around[beyond] - level
    probability = SHIFT_FALSE_ALARMS * 6.0 / (math.pi * number) ** 2
    variance, sigma = float((apart**2).mean()), norm.isf(probability / near.size)
    # In dim frames the correlation counts coincidences; kappa_3 / kappa_2 is the size of one in Bernstein's inequality.
    by_count = sigma**2 * max(float((apart**3).mean()), 0.0) / max(variance, np.finfo(np.float64).tiny) / 6.0
    if near.max() - level < by_count + math.hypot(by_count, sigma * math.sqrt(variance)):
        return 0.0, 0.0
    peak = np.array(np.unravel_index(near.argmax(), near.shape))
    finer = []
    for axis, middle in enumerate(peak):
        if not 0 < middle < 2 * reach:
            return 0.0, 0.0
        before, here, after = (near[tuple(peak + step * np.eye(2, dtype=int)[axis])] for step in (-1, 0, 1))
        bend = float(before - 2.0 * here + after)
        finer.append(float(middle) - reach + (0.5 * float(before - after) / bend if bend < 0.0 else 0.0))
    return finer[0], finer[1]
