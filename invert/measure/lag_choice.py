"""Number of lags and lag pitch for an object: as wide as the object and as fine as the signal-to-noise ratio permits.

The choice begins with 64 lags of 300 um. A wider object gets more lags of this pitch; an object of a few lags, lags of a finer
pitch. The pitch is halved while the upper half of the spatial frequencies holds more power of the object than noise, because
finer lags then show more of it; their number follows from the extent of the object.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from correlograph.errors import InputError
from correlograph.lags import OBJECT_SIDE
from correlograph.ranges import LAG_COUNT
from invert.measure.patch_fit import MIN_EXTENT_LAGS, is_wider_than_lags, signal_extent_lags
from invert.measure.spectrum import Measurement
from radiometry.autocorrelation import PatchGrid, patch_grid

MAX_ZOOMED_EXTENT_LAGS = 12
"""Objects of at most this extent are magnified to `MIN_EXTENT_LAGS`."""

MIN_UPPER_SNR = 1.0
"""Minimum ratio of signal to noise in the upper half of the spatial frequencies for finer lags: the usual limit of resolution."""


WINDOW_EXTENT = 1.3
"""Width of the lag window in extents of the object; the noise level is read from the lags beyond the object."""

SIDE_STEP = 8
"""The sides of albedos are multiples of this number, because the U-net halves them three times."""


@dataclass(frozen=True)
class LagChoice:
    """A grid, and one sentence that says why it was chosen."""

    grid: PatchGrid
    reason: str


def choose_lags(grid: PatchGrid, measured: Callable[[PatchGrid], Measurement]) -> LagChoice:
    """Choose the grid of the lags, starting with `grid`.

    Args:
        measured: returns the measurement on a grid.
    """
    measurement = measured(grid)
    if not measurement.detectable:
        return LagChoice(grid, "default, because no object is detected")
    reasons = []
    while is_wider_than_lags(measurement) and (wider := _wider(grid)) is not None:
        grid, measurement = wider, measured(wider)
        reasons.append("the object is wide")
    extent = max(signal_extent_lags(measurement), 1)
    if not reasons and extent <= MAX_ZOOMED_EXTENT_LAGS and (larger := _magnify(grid, MIN_EXTENT_LAGS / extent)) is not None:
        grid, measurement = larger, measured(larger)
        reasons.append("the object is small")
    while upper_snr(measurement) >= MIN_UPPER_SNR and (finer := _finer(grid, signal_extent_lags(measurement))) is not None:
        grid, measurement = finer, measured(finer)
        reasons.append("the signal-to-noise ratio permits finer lags")
    return LagChoice(grid, " and ".join(dict.fromkeys(reasons)) or "default, which suits the object")


def upper_snr(measurement: Measurement) -> float:
    """Return the ratio of signal to noise of the power spectrum of an object in the upper half of the spatial frequencies.

    The standard deviation of |F(r)|^2 over the frequencies equals its mean, so the ratio is computed from the variance of the
    power spectrum. The mean is not used, because it depends on the extrapolated zero lag. The noise of each lag has the variance
    S^2 / K and is white in the power spectrum.
    """
    noise, grid = measurement.noise, measurement.lag_grid
    if not noise.dof:
        return np.inf
    used = grid.ring <= noise.signal_ring + 1
    excess = np.where(used, measurement.values.astype(np.float64) - noise.floor, 0.0)
    padded = np.zeros((grid.padded_side, grid.padded_side))
    padded[: grid.side, : grid.side] = excess
    power = np.fft.fft2(np.roll(padded, (-grid.lags, -grid.lags), (0, 1))).real
    variance = noise.inflation * float((measurement.values[used].astype(np.float64) ** 2).sum()) / noise.dof
    frequency = np.hypot(np.fft.fftfreq(len(power))[:, None], np.fft.fftfreq(len(power))[None])
    return float(np.sqrt(max(power[(frequency > 0.25) & (frequency <= 0.5)].var() / variance - 1.0, 0.0)))


def _wider(grid: PatchGrid) -> PatchGrid | None:
    """Return the grid with twice the lags of the same patches, or None if these have too few pixels."""
    return _valid(grid, grid.patch_shape, 2 * grid.lags + 1)


def _magnify(grid: PatchGrid, factor: float) -> PatchGrid | None:
    """Return the grid with patches larger by a factor, at most half of the frame; None if they are not larger."""
    sizes = [min(round(factor * size), side // 2) for size, side in zip(grid.patch_shape, grid.frame_shape, strict=True)]
    return _valid(grid, (sizes[0], sizes[1]), grid.lags) if sizes[0] > grid.patch_shape[0] else None


def _finer(grid: PatchGrid, extent: int) -> PatchGrid | None:
    """Return the grid of half the lag pitch for an object of an extent in lags; None if the frame or the lag limit forbids it."""
    rows, columns = grid.patch_shape
    if 2 * rows > grid.frame_shape[0] // 2 or 2 * columns > grid.frame_shape[1] // 2:
        return None
    side = max(OBJECT_SIDE, SIDE_STEP * math.ceil(2 * WINDOW_EXTENT * extent / SIDE_STEP))
    return _valid(grid, (2 * rows, 2 * columns), min(side - 1, 2 * grid.lags + 1))


def _valid(grid: PatchGrid, patch: tuple[int, int], lags: int) -> PatchGrid | None:
    if not LAG_COUNT.holds(lags):
        return None
    try:
        return patch_grid(grid.frame_shape, patch, lags)
    except InputError:
        return None
