"""Patch size for the object: small enough that the lags contain it, large enough that it covers more than a few lags.

The lag pitch is lambda z / (patch size x pixel pitch). An object wider than 64 lags needs smaller patches. An object of a few lags
shows more detail in larger ones, with fewer degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from invert.measure.spectrum import Measurement
from radiometry.autocorrelation import PatchGrid, patch_grid

MIN_EXTENT_LAGS, MAX_EXTENT_LAGS = 24.0, 44.0
"""Target extents in lags (the grid has 64): smaller objects are enlarged to the first, wider ones reduced to the second."""

MAX_RELIABLE_EXTENT = 50 / 64
"""Extent, as a fraction of the lags, above which an object may be wider than these."""

MAX_SIZE_RATIO, MIN_SIZE_RATIO = 2.0, 1.2
"""Maximum change of the patch size, and the minimum one that is worth a second estimate."""

ENCLOSED_SIGNAL_FRACTION = 0.98
"""Fraction of the signal inside an object's extent; the rest is leakage of patches and noise."""


def is_wider_than_lags(measurement: Measurement) -> bool:
    """Return whether the object may be wider than the lags."""
    return measurement.detectable and signal_extent_lags(measurement) >= MAX_RELIABLE_EXTENT * measurement.lag_grid.object_side


def signal_extent_lags(measurement: Measurement) -> int:
    """Return the extent of r*r in lags, about the width of the object."""
    lags = measurement.lag_grid
    excess = np.where(lags.half_plane, measurement.values.astype(np.float64) - measurement.noise.floor, 0.0)
    inside = np.bincount(lags.ring.ravel(), excess.ravel(), lags.lags + 1).cumsum()
    return int(np.argmax(inside >= ENCLOSED_SIGNAL_FRACTION * inside[-1]))


def choose_patch_grid(grid: PatchGrid, measured: Callable[[PatchGrid], Measurement]) -> PatchGrid:
    """Return the grid for the object; `grid` itself if it is suitable or no object is detected.

    Patch sizes change by a factor of at most two and stay between 127 pixels (all lags fit) and half of the frame.

    Args:
        measured: returns the measurement on a grid.
    """
    first = measured(grid)
    if not first.detectable:
        return grid
    if not is_wider_than_lags(first):
        return _enlarge_patches(grid, MIN_EXTENT_LAGS / max(signal_extent_lags(first), 1.0))
    half = _scale_patches(grid, 1.0 / MAX_SIZE_RATIO)
    return _enlarge_patches(half, MAX_EXTENT_LAGS / max(signal_extent_lags(measured(half)), 1.0))


def _enlarge_patches(grid: PatchGrid, ratio: float) -> PatchGrid:
    """Return a grid of larger patches; `grid` itself if `ratio` is close to 1."""
    return _scale_patches(grid, min(ratio, MAX_SIZE_RATIO)) if ratio >= MIN_SIZE_RATIO else grid


def _scale_patches(grid: PatchGrid, ratio: float) -> PatchGrid:
    sizes = [
        min(max(round(size * ratio), grid.lag_grid.side), max(side // 2, size))
        for size, side in zip(grid.patch_shape, grid.frame_shape, strict=True)
    ]
    return patch_grid(grid.frame_shape, (sizes[0], sizes[1]), grid.lags)
