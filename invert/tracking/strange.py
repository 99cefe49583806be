"""Frames that show something else than those beside them, or nothing: the beam was blocked, or a lamp flashed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline, interp1d

from invert.tracking.band import Band
from invert.tracking.parts import sum_over_rows
from invert.tracking.shifts import move_back, weight_of

STRANGE_SIGMA = 4.5
"""Significance below which two frames share nothing."""

CLEAR_SIGMA = 9.0
"""Median significance of frames beside each other from which one that shares nothing is no noise."""

MIN_KNOWN = 4
"""Least number of other frames from which positions are interpolated."""


def are_strange(spectra: np.ndarray, band: Band, places: np.ndarray) -> np.ndarray:
    """Return whether each of the frames (n, R, C) at places (n, 2) shares nothing with the two before and the two after it, bool (n,).

    None is strange if most frames do not clearly share their speckle with the next one.
    """
    beside = shared_sigma(spectra, band, places, 1)
    best = np.maximum(np.append(beside, -np.inf), np.append(-np.inf, beside))
    if (best >= STRANGE_SIGMA).all() or float(np.median(beside)) < CLEAR_SIGMA or len(spectra) < 3:
        return np.zeros(len(spectra), bool)
    beyond, ends = shared_sigma(spectra, band, places, 2), [-np.inf, -np.inf]
    strange = np.maximum.reduce([best, np.append(beyond, ends), np.append(ends, beyond)]) < STRANGE_SIGMA
    return strange & (int((~strange).sum()) >= MIN_KNOWN)


def shared_sigma(spectra: np.ndarray, band: Band, places: np.ndarray, apart: int) -> np.ndarray:
    """Return the significance of what frames some numbers apart have in common at their places (n, 2), in standard deviations of
    frames of their own power spectra that share nothing, (n - apart,).

    The weight is that of noisy frames, so that dim frames beside bright ones count, too.
    """
    values = weight_of(replace(band, floor=band.floor + band.signal.max()), 0.0).values.astype(np.float32)
    squares = (values**2 / np.maximum(band.counts, 1.0)).astype(np.float32)

    def sums(rows: slice) -> np.ndarray:
        moved = move_back(spectra[:, rows], band.part(rows), places)
        powers = moved.real**2 + moved.imag**2
        height = np.vecdot(moved[:-apart] * values[rows], moved[apart:]).real.sum(1, dtype=np.float64)
        return np.stack([height, (powers[:-apart] * powers[apart:] * squares[rows]).sum((1, 2), dtype=np.float64)])

    height, variance = sum_over_rows(sums, spectra)
    return height / np.maximum(band.noise_gain * variance, 1e-300) ** 0.5


def interpolate(
    path: np.ndarray, error: np.ndarray, numbers: np.ndarray, strange: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return a path (n, 2) from the first frame and its errors (n, 2) with interpolated positions of strange frames.

    Between known frames, a cubic curve joins them; beyond them, a straight line. The error grows with the distances a and b, in frames, of
    the known frames on both sides, like that of a line in place of a path of the same second differences: by a b / 2 of their rms, or
    beyond the ends by a (a + 1) / 2.

    Args:
        numbers: number of each frame, of which some may be missing, (n,).
    """
    known = np.setdiff1d(np.arange(len(path)), strange)
    at, places = numbers[known].astype(np.float64), path[known]
    inside = (numbers > at[0]) & (numbers < at[-1])
    line, curve = interp1d(at, places, axis=0, fill_value="extrapolate"), CubicSpline(at, places)
    filled = np.where(inside[:, None], curve(numbers), line(numbers))
    filled[known] = places
    steps = np.diff(places, axis=0) / np.diff(at)[:, None]
    bend = np.sqrt(np.mean(np.diff(steps, axis=0) ** 2, 0))
    after = np.clip(np.searchsorted(at, numbers), 1, len(at) - 1)
    before, later = np.abs(numbers - at[after - 1]), np.abs(at[after] - numbers)
    nearest = np.minimum(before, later)
    bends = 0.5 * np.where(inside, before * later, nearest * (nearest + 1.0))
    errors = np.stack([np.interp(numbers, at, one) for one in error[known].T], 1)
    errors = np.hypot(errors, bends[:, None] * bend)
    errors[known] = np.hypot(error[known], errors[0] if 0 in strange else 0.0)
    errors[0] = 0.0
    return filled - filled[0], errors
