"""Patch size that suits the object: small enough that the lags hold it, large enough that it is more than a spot.

The lag pitch is lambda z / (patch size x pixel pitch). An object wider than 64 lags needs smaller patches; one of a few
lags shows more in larger ones, if at fewer degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from correlograph.lags import LAG_SIDE, LAGS
from invert.measure.spectrum import Measurement
from radiometry.autocorrelation import PatchGrid, patch_grid
from radiometry.noise.level import INDEPENDENT, RING

LEAST_FILLED, MOST_FILLED = 24.0, 44.0
"""Lags, of 64, up to which a small object is magnified and a large one reduced."""

OVERFULL = 50
"""Extent from which on an object may be wider than the lags show."""

LARGEST_CHANGE, LEAST_CHANGE = 2.0, 1.2

HELD = 0.98
"""Share of the signal inside an object's extent; the rest is leakage of patches, and noise."""


def overfull(measurement: Measurement) -> bool:
    """Whether the object may be wider than the lags show."""
    return measurement.detectable and extent(measurement) >= OVERFULL


def extent(measurement: Measurement) -> int:
    """How far r*r reaches, in lags: about the width of the object."""
    excess = np.where(INDEPENDENT, measurement.estimate.astype(np.float64) - measurement.noise.floor, 0.0)
    inside = np.bincount(RING.ravel(), excess.ravel(), LAGS + 1).cumsum()
    return int(np.argmax(inside >= HELD * inside[-1]))


def fitting_grid(grid: PatchGrid, measured: Callable[[PatchGrid], Measurement]) -> PatchGrid:
    """The grid that suits the object; `grid` itself where it does, or none is found.

    Patches change by a factor of two at most, and stay between 127 pixels (all lags fit) and half of the frame.

    Args:
        measured: the measurement on a grid.
    """
    first = measured(grid)
    if not first.detectable:
        return grid
    if not overfull(first):
        return _changed(grid, LEAST_FILLED / max(extent(first), 1.0))
    half = _resized(grid, 1.0 / LARGEST_CHANGE)
    return _changed(half, MOST_FILLED / max(extent(measured(half)), 1.0))


def _changed(grid: PatchGrid, ratio: float) -> PatchGrid:
    """With larger patches, where that is a change worth making."""
    return _resized(grid, min(ratio, LARGEST_CHANGE)) if ratio >= LEAST_CHANGE else grid


def _resized(grid: PatchGrid, ratio: float) -> PatchGrid:
    sizes = [min(max(round(size * ratio), LAG_SIDE), max(side // 2, size))
             for size, side in zip(grid.patch_shape, grid.frame_shape, strict=True)]
    return patch_grid(grid.frame_shape, (sizes[0], sizes[1]))
