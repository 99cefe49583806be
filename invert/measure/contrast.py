"""Contrast of the speckle in frames.

Speckle of one polarisation has contrast 1: its variance, the sum of the signal over the lags, is the square of its mean. Light that throws
no speckle, a second polarisation and blur lower the contrast; nothing raises it. It therefore limits how much the frames can be blurred.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from invert.measure.spectrum import Measurement
from radiometry.autocorrelation import PatchGrid

SQUARED_ERROR = 4.0
"""Squared relative error of variance over squared mean, times the number of grains: 8 of the variance of an exponential variable, 4 of its
squared mean, less 8 because both rise together."""

FULL_SIGMA = 3.0
"""Standard errors by which the squared contrast must lie below 1 for a blur to be possible."""

MAX_CONTRAST_SQUARE, CONTRAST_SIGMA = 1.2, 4.0
"""Squared contrast that uneven light explains, and standard errors beyond it without a remark; speckle has 1 at most."""


@dataclass(frozen=True)
class Contrast:
    """Squared contrast of the speckle and its standard error. Pupil and pixels of the camera, but no blur, are divided out."""

    square: float
    error: float

    @property
    def is_full(self) -> bool:
        """Whether the contrast may be 1, which leaves no room for blur."""
        return self.square + FULL_SIGMA * self.error >= 1.0

    @property
    def is_too_high(self) -> bool:
        """Whether the contrast is higher than light makes it."""
        return self.square - CONTRAST_SIGMA * self.error > MAX_CONTRAST_SQUARE

    def as_dict(self) -> dict[str, Any]:
        """Return the contrast for JSON."""
        value = self.square**0.5
        return {"contrast": value, "standard_error": 0.5 * self.error / value}


def signal_sum(measurement: Measurement) -> float:
    """Return the signal above the floor, summed over its lags."""
    return float((measurement.values.astype(np.float64) - measurement.noise.floor)[_inside(measurement)].sum())


def find_contrast(measurement: Measurement, grid: PatchGrid, frames: int, mean_square: float) -> Contrast | None:
    """Return the contrast of frames; None without a detectable signal.

    Args:
        mean_square: mean over the frames of the square of their mean, in their unit.
    """
    noise, inside, total = measurement.noise, _inside(measurement), signal_sum(measurement)
    if not measurement.detectable or not noise.dof or mean_square <= 0.0 or total <= 0.0:
        return None
    signal, area = (measurement.values.astype(np.float64) - noise.floor)[inside], float(np.prod(grid.patch_shape))
    grains = frames * float(np.prod(grid.frame_shape)) / area * total**2 / float((signal**2).sum())
    # A lag and its opposite are one number. The floor comes from the lags outside.
    lags, outside = inside.sum(), max((~inside).sum(), 1)
    of_noise = noise.deviation * float(2.0 * noise.inflation * lags * (1.0 + lags / outside)) ** 0.5
    relative = (SQUARED_ERROR / grains + (of_noise / total) ** 2) ** 0.5
    square = total / area / mean_square
    return Contrast(square, square * relative)


def _inside(measurement: Measurement) -> np.ndarray:
    return measurement.lag_grid.ring <= measurement.noise.signal_ring
