"""Exact path of one object: each frame is registered to the sum of the frames around it, moved to their own positions.

The speckle stays the same while the object moves by a fraction of a grain of its illumination. Within this reach, the sum of M frames shows
it with M times less noise than one, and the error of a frame's position approaches that for a known pattern. Frames too dim to be
registered alone are summed in groups of two, four and so on, as they move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invert.tracking.shifts import aligned, refine, weight_of
from invert.tracking.spectra import Band
from invert.tracking.start import Start

MIN_GROUP_SIGNIFICANCE = 5.0
"""Median significance of a group of frames in its surroundings from which it is registered on its own."""

LONGEST_REACH = 16
"""Number of groups on each side, at most, to which one is registered."""

FADED = 0.6
"""Share of the common speckle of neighbours that groups must still have in common."""

ROUNDS = 4


@dataclass(frozen=True)
class Followed:
    """Path of an object.

    Attributes:
        path: position of its speckle in each frame from the first, (frames, 2) pixels.
        error: standard error of each position, (frames, 2).
        frames_per_group: number of frames that were registered together.
        common: share of the speckle that neighbouring groups have in common.
    """

    path: np.ndarray
    error: np.ndarray
    frames_per_group: int
    common: float


def follow(spectra: np.ndarray, band: Band, start: Start) -> Followed:
    """Return the path of an object near an approximate one; spectra (frames, R, C)."""
    path, length = start.path, 1
    while True:
        groups = np.array_split(np.arange(len(path)), max(2, len(path) // length))
        middles = np.array([group.mean() for group in groups])
        sums = np.stack([aligned(spectra[group], band, path[group] - path[group].mean(0)).sum(0) for group in groups])
        of_group = Band(band.shape, band.rows, band.columns, band.counts, band.signal * length**2, band.floor * length)
        places, error, common, significance = _register(sums, of_group, np.stack([path[group].mean(0) for group in groups]))
        if significance >= MIN_GROUP_SIGNIFICANCE or len(groups) <= 4:
            break
        length *= 2
    # Within a group, the approximate path gives the motion about its mean.
    numbers = np.arange(len(path))
    moved = places - np.stack([path[group].mean(0) for group in groups])
    found = path + np.stack([_interpolate(numbers, middles, moved[:, axis]) for axis in (0, 1)], 1)
    errors = np.stack([np.interp(numbers, middles, error[:, axis]) for axis in (0, 1)], 1)
    from_first = np.hypot(errors, errors[0])
    from_first[0] = 0.0
    return Followed(found - found[0], from_first, length, common)


def _register(sums: np.ndarray, band: Band, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return positions of groups (n, 2), their standard errors, the common share of neighbours, and the median significance."""
    count, reach, common = len(sums), 1, 1.0
    for _ in range(ROUNDS):
        moved = aligned(sums, band, places)
        alike = _likeness(moved, band)
        common = float(np.clip(alike[0], 0.05, 1.0))
        far = np.flatnonzero(alike < FADED * alike[0])
        reach = int(np.clip(far[0] if len(far) else LONGEST_REACH, 1, min(LONGEST_REACH, count - 1)))
        total = np.concatenate([np.zeros_like(moved[:1]), np.cumsum(moved, 0)])
        low, high = (np.clip(np.arange(count) + side, 0, count) for side in (-reach, reach + 1))
        around = total[high] - total[low] - moved
        weight = weight_of(band, common, int(np.median(high - low - 1)))
        shifts = refine(around.conj() * moved, band, weight, np.zeros((count, 2)))
        places = places + shifts.pixels
    variance = np.diagonal(shifts.covariance, axis1=1, axis2=2)
    # Errors of neighbours add up over distances beyond the reach.
    walked = np.arange(count)[:, None] / reach * 2.0 * variance / (2.0 * reach)
    significance = float(np.median(shifts.height)) / weight.deviation
    return places, np.sqrt(variance + walked), common, significance


def _likeness(moved: np.ndarray, band: Band) -> np.ndarray:
    """Return the share of the speckle that groups 1, 2, ... apart have in common, (at most `LONGEST_REACH`,)."""
    weight = np.where(band.counts > 0.0, band.counts / np.maximum(band.signal + band.floor, 1e-300), 0.0)
    full = (weight * band.signal).sum()
    steps = range(1, min(LONGEST_REACH + 1, len(moved)))
    return np.array([float(((moved[:-step].conj() * moved[step:]).real.mean(0) * weight).sum() / full) for step in steps])


def _interpolate(at: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate linearly, and continue linearly beyond the ends."""
    from scipy.interpolate import interp1d

    return interp1d(known, values, fill_value="extrapolate")(at)
