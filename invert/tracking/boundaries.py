"""Likeness of the frames on both sides of each boundary between two frames, along a path."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from invert.tracking.band import Band
from invert.tracking.parts import sum_over_rows
from invert.tracking.shares import MIN_OVERLAP
from invert.tracking.shifts import MIN_SIGNIFICANCE, Weight, move_back, overlap_share, weight_of

MAX_LOW, MIN_HIGH = 0.3, 0.45
"""Likeness of frames, over the usual one, below which a jump is sought, and above which it is found. The interference of two objects
lowers it to any value, but is nowhere as high as the speckle of one."""

USUAL = 0.9
"""Quantile of the likeness at all boundaries along a path that counts as usual."""

BREAK_SIGMA = 8.0
"""Least significance of the usual likeness at which its absence is no noise: below three standard deviations once in 10^6 boundaries."""


class Boundaries(NamedTuple):
    """Likeness of the frames before and after each boundary along a path.

    Attributes:
        group: number of frames on each side.
        alike: over the light of both sides and the overlap of their windows, (frames - 1,).
        scale: height of the cross-correlation for an `alike` of 1, in standard deviations, (frames - 1,).
        weight: weight of the cross-spectra.
    """

    group: int
    alike: np.ndarray
    scale: np.ndarray
    weight: Weight

    @property
    def usual(self) -> float:
        """Likeness at nearly all boundaries."""
        return float(np.quantile(self.alike, USUAL))

    @property
    def are_clear(self) -> np.ndarray:
        """Whether each boundary would show a jump, bool (frames - 1,)."""
        return MIN_HIGH * self.usual * self.scale > MIN_SIGNIFICANCE

    @property
    def is_clear(self) -> bool:
        """Whether most boundaries would show a jump."""
        return float(self.are_clear.mean()) >= 0.5

    @property
    def show_breaks(self) -> np.ndarray:
        """Whether each boundary would show that its sides share nothing, bool (frames - 1,)."""
        return self.usual * self.scale > BREAK_SIGMA

    @property
    def is_continuous(self) -> bool:
        """Whether no boundary shows a jump, although most would."""
        return self.is_clear and float(self.alike.min()) >= MAX_LOW * self.usual


def boundaries_along(spectra: np.ndarray, band: Band, light: np.ndarray, path: np.ndarray, group: int) -> Boundaries:
    """Return the likeness of the `group` frames before and after each boundary along a path; see `light_of_frames`."""
    weight = _weight_of_sums(spectra, band, path, group)

    def measure(rows: slice) -> np.ndarray:
        before, after = _sums(move_back(spectra[:, rows], band.part(rows), path), group)
        return np.vecdot(before * weight.values[rows].astype(np.float32), after).real.sum(1).astype(np.float64)

    before, after = _sums(light[:, None], group)
    counts = _sums(np.ones((len(path), 1)), group)
    overlap = np.maximum(overlap_share(np.diff(path, axis=0), band), MIN_OVERLAP)
    expected = weight.full * (before * after)[:, 0] * overlap
    deviation = weight.deviation * np.sqrt(counts[0] * counts[1])[:, 0]
    return Boundaries(group, sum_over_rows(measure, spectra) / expected, expected / deviation, weight)


def _weight_of_sums(spectra: np.ndarray, band: Band, path: np.ndarray, group: int) -> Weight:
    """Return the weight of cross-spectra of sums of `group` frames along a path, in which their common speckle counts as that of single
    frames does. It adds up to more than the noise of the frames, and what two sums do not share is noise, too."""
    of_frame, group = weight_of(band, 0.0), min(group, len(path) - 1)
    if group == 1:
        return of_frame

    def power(rows: slice) -> np.ndarray:
        before = _sums(move_back(spectra[:, rows], band.part(rows), path), group)[0][group - 1 :]
        return (np.vecdot(before, before, axis=0).real * of_frame.values[rows]).sum()

    of_sums = float(sum_over_rows(power, spectra)) / (len(path) - group) / group
    gain = (of_sums - (of_frame.values * band.floor).sum()) / of_frame.full
    gain = float(np.clip(gain, 1.0, group))
    found = weight_of(replace(band, signal=gain * band.signal), 0.0)
    scale = gain * of_frame.full / found.full
    return replace(
        found,
        values=scale * found.values,
        products=scale**2 * found.products,
        deviation=scale * found.deviation,
        full=of_frame.full,
    )


def _sums(values: np.ndarray, group: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums of the `group` entries of (n, ...) before and after each boundary, (n - 1, ...) each."""
    if group == 1:
        return values[:-1], values[1:]
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, 0)])
    boundary = np.arange(1, len(values))
    first, last = np.maximum(boundary - group, 0), np.minimum(boundary + group, len(values))
    return total[boundary] - total[first], total[last] - total[boundary]
