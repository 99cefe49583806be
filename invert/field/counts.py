"""From frames to photon counts: calibration from the frames themselves, unmeasured pixels, held-out pixels, background.

A camera delivers values of unknown gain, offset and read noise. An affine map turns them into counts whose variance equals their
mean, for which the Poisson likelihood holds: the gain follows from photon transfer, the shift from the noise floor of the estimate. A
positive shift is the variance of the read noise in electrons squared (shifted Poisson; Snyder, Hammoud and White,
doi:10.1364/JOSAA.10.001014), a negative one removes an offset.

Speckle of one polarisation has contrast 1, so the variance of a frame determines its mean signal; the rest of the mean is background.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from invert.field.grid import FieldGrid
from radiometry.estimation.illumination import relative_illumination
from radiometry.estimation.photon_transfer import MAX_VARIANCE_RATIO, combine, photon_transfer
from radiometry.estimation.pixel_faults import repair

HELD_OUT_FRACTION = 0.05
"""Fraction of the measured pixels that no fit uses; the certificate compares predictions with them."""

MAX_GAIN_ERROR = 0.1
"""Maximum relative error of the gain by photon transfer; above it, all noise counts as shot noise."""

SIGNIFICANT_SIGMA = 3.0
"""Standard errors by which a shift or a background must differ from its default to be used."""

KURTOSIS_FACTOR = 8.0
"""Squared relative error of the variance of speckle times the number of grains: mu_4 / sigma^4 - 1 of an exponential variable."""


@dataclass(frozen=True)
class Calibration:
    """Map from frame values to counts: counts = value / gain + shift, per camera pixel.

    Attributes:
        gain: frame units per electron.
        shift: counts added to a camera pixel: the variance of the read noise, or minus an offset.
    """

    gain: float
    shift: float

    @classmethod
    def of(cls, frames: Sequence[np.ndarray], floor: float) -> Calibration:
        """Derive the map from some frames and the noise floor of the estimate: the variance of a pixel's noise in frame units
        squared.
        """
        images = [repair(torch.as_tensor(np.ascontiguousarray(frame, np.float32)))[0] for frame in frames]
        noise, level = (
            combine([photon_transfer(image) for image in images]),
            float(np.mean([float(one.mean()) for one in images])),
        )
        is_measured = noise.gain > 0.0 and noise.error < MAX_GAIN_ERROR * noise.gain
        if not is_measured or noise.variance > MAX_VARIANCE_RATIO * floor:
            return cls(floor / level, 0.0)
        shift = (noise.variance / noise.gain - level) / noise.gain
        error = abs(level) / noise.gain * 2.0 * noise.error / noise.gain
        return cls(noise.gain, shift if abs(shift) > SIGNIFICANT_SIGMA * error else 0.0)


@dataclass(frozen=True)
class FrameCounts:
    """Counts of one frame on the binned grid (rows, columns).

    Attributes:
        values: counts, zero or more.
        fitted: pixels that fits use.
        held_out: measured pixels that only the certificate uses.
        illumination: relative illumination of the wall, mean 1.
        background: expected counts of a binned pixel without light of the object.
        signal: expected counts of a binned pixel by light of the object.
    """

    values: torch.Tensor
    fitted: torch.Tensor
    held_out: torch.Tensor
    illumination: torch.Tensor
    background: float
    signal: float


def read_counts(
    frame: np.ndarray, calibration: Calibration, grid: FieldGrid, rng: torch.Generator, uneven_patch: tuple[int, int] | None
) -> FrameCounts:
    """Return the counts of a frame, with all of the mean counted as signal.

    Args:
        uneven_patch: patch of the estimate if its illumination is uneven (`radiometry.estimation.illumination`).
    """
    image = torch.as_tensor(np.ascontiguousarray(frame, np.float32))
    repaired, _ = repair(image)
    pixels = grid.binning[0] * grid.binning[1]
    values = (grid.bin(repaired.numpy()) / calibration.gain + pixels * calibration.shift).clamp_min_(0.0)
    measured = grid.bin((repaired != image).float().numpy()) == 0.0
    held_out = measured & (torch.rand(values.shape, generator=rng) < HELD_OUT_FRACTION)
    illumination = torch.ones(())
    if uneven_patch is not None:
        illumination = grid.bin(relative_illumination(repaired, uneven_patch).numpy()) / pixels
    mean = float(values[measured].mean(dtype=torch.float64))
    background = pixels * max(calibration.shift, 0.0)
    return FrameCounts(values, measured & ~held_out, held_out, illumination, background, max(mean - background, 1e-6))


def background_of(frames: Sequence[FrameCounts], variance_transfer: float, grains: float) -> float:
    """Return the background of a binned pixel, from the contrast of frames.

    The variance of the counts in excess of their mean is the squared signal times `variance_transfer`.

    Args:
        variance_transfer: fraction of the variance of the speckle that the camera transmits.
        grains: number of speckle grains per frame.
    """
    default = frames[0].background
    excess = []
    for one in frames:
        values = (one.values / one.illumination)[one.fitted].double()
        square = max(float(values.var()) - float((one.values / one.illumination.square())[one.fitted].mean()), 0.0)
        excess.append(float(values.mean()) - (square / variance_transfer) ** 0.5)
    signal = float(np.mean([one.signal for one in frames]))
    error = 0.5 * signal * (KURTOSIS_FACTOR / (grains * len(frames))) ** 0.5
    found = float(np.mean(excess))
    return max(found, 0.0) if found - default > SIGNIFICANT_SIGMA * error else default
