"""Share of the power of the speckle that frames have in common along a path."""

from __future__ import annotations

import numpy as np

from invert.tracking.band import Band
from invert.tracking.light import weighted_powers
from invert.tracking.parts import sum_over_rows
from invert.tracking.shifts import Weight, heights_at, overlap_share, weight_of

MIN_OVERLAP = 0.1
"""Least overlap of the windows of two frames that is corrected for."""


class Shares:
    """Shares of the speckle that frames have in common, from their spectra (frames, R, C).

    Args:
        light: amplitude of the speckle in each frame, (frames,), by whose products shares are divided; all are equal without it.
    """

    def __init__(self, spectra: np.ndarray, band: Band, light: np.ndarray | None = None) -> None:
        self._spectra, self._band, self._weight = spectra, band, weight_of(band, 0.0)
        self._light = np.ones(len(spectra)) if light is None else light
        own = float(weighted_powers(spectra, self._weight.values)[0].mean())
        self._whole = whole_height(own, len(spectra), band, self._weight) / float((self._light**2).mean())

    def along(self, path: np.ndarray, lag: int) -> float:
        """Return the share that frames `lag` apart have in common along a path (frames, 2)."""
        spectra, steps = self._spectra, path[lag:] - path[:-lag]

        def heights(rows: slice) -> np.ndarray:
            cross = spectra[:-lag, rows].conj() * spectra[lag:, rows]
            return heights_at(cross, self._band.part(rows), self._weight.part(rows), steps)

        alike = float(sum_over_rows(heights, spectra).mean())
        seen = float((self._light[lag:] * self._light[:-lag]).mean())
        return alike / (self._whole * seen * mean_overlap(steps, self._band))

    def noise(self, pairs: int) -> float:
        """Return the standard deviation of the share of a number of pairs of frames that have nothing in common."""
        return self._weight.deviation / (self._whole * pairs**0.5)


def whole_height(own: float, frames: int, band: Band, weight: Weight) -> float:
    """Return the height of the cross-correlation of frames whose speckle is wholly common, from their mean power, summed with a weight; at
    least its noise.

    The power of a band is smoothed: it is up to three times as wide as that of a few large grains. What the window leaks is not subtracted,
    because it is speckle that frames have in common, too.
    """
    noise = 2.0**0.5 * weight.deviation / frames**0.5
    return max(own - float(weight.values.sum()) * band.noise, noise, 1e-300)


def mean_overlap(steps: np.ndarray, band: Band) -> float:
    """Return the mean overlap of the windows of two frames at displacements (n, 2), at least `MIN_OVERLAP`."""
    return max(float(overlap_share(steps, band).mean()), MIN_OVERLAP)
