"""From frames to photon counts: calibration from the frames themselves, unmeasured pixels, held-out pixels, background.

A camera delivers values of unknown gain, offset and read noise. An affine map turns them into counts whose variance equals their
mean, for which the Poisson likelihood holds; gain and shift follow from the variance of the noise over the light. A positive shift is the
variance of the read noise in electrons squared (shifted Poisson; Snyder, Hammoud and White, doi:10.1364/JOSAA.10.001014), a negative one
removes an offset. Subjective speckle of a rough wall adds a variance that grows with the square of the light.

Speckle of one polarisation has contrast 1, so the variance of a frame determines its mean signal; the rest of the mean is background.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from correlograph.errors import InputError
from invert.field.grid import FieldGrid
from radiometry.estimation.illumination import relative_illumination
from radiometry.estimation.noise_curve import noise_curve
from radiometry.estimation.photon_transfer import MAX_VARIANCE_RATIO
from radiometry.estimation.pixel_faults import repair

HELD_OUT_FRACTION = 0.05
"""Fraction of the measured pixels that no fit uses; the certificate compares predictions with them."""

MAX_GAIN_ERROR = 0.1
"""Maximum relative error of a measured gain; above it, all noise counts as shot noise."""

MIN_HELD_OUT = 60
"""Minimum number of held-out pixels of a frame."""

MIN_ILLUMINATION = 0.1
"""Relative illumination below which a pixel counts as unmeasured."""

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
        roughness: relative variance of the light of a camera pixel by the subjective speckle of the rough wall.
    """

    gain: float
    shift: float = 0.0
    roughness: float = 0.0

    @classmethod
    def of(
        cls, frames: Sequence[np.ndarray], floor: float, gain: float | None = None, used: np.ndarray | None = None
    ) -> Calibration:
        """Derive the map from some frames.

        Args:
            floor: noise floor of the estimate: variance of a pixel's noise in frame units squared.
            gain: frame units per electron, if it is known.
            used: pixels (H, W) that hold a measurement; None for all.

        Raises InputError for frames whose mean is not positive.
        """
        images, masks = zip(*(repair_frame(frame, used) for frame in frames), strict=True)
        level = float(np.mean([float(image[mask].mean()) for image, mask in zip(images, masks, strict=True)]))
        if not level > 0.0:
            found = f"a mean of {level:.3g}"
            raise InputError("frames", "light in the first frames for --method field", found, "check dark frame and exposure")
        floor = floor / (1.0 if used is None else float(used.mean()))  # pixels that hold a mean have no noise
        curve = noise_curve(images, masks)
        if gain is not None:
            curve = curve.given(1, gain)
        if curve.coefficients[2] < SIGNIFICANT_SIGMA * curve.errors[2] or curve.coefficients[1] <= 0.0:
            curve = curve.given(2, 0.0)
        offset, slope, roughness = curve.coefficients
        square = float(np.mean([float(image[mask].square().mean()) for image, mask in zip(images, masks, strict=True)]))
        variance = (offset + slope * level + roughness * square) / (1.0 + roughness)
        is_measured = gain is not None or curve.errors[1] < MAX_GAIN_ERROR * slope
        if not is_measured or variance > MAX_VARIANCE_RATIO * floor:
            return cls(gain or floor / level)
        is_shifted = abs(offset) > SIGNIFICANT_SIGMA * curve.errors[0]
        return cls(float(slope), float(offset / slope**2) if is_shifted else 0.0, float(roughness))


def repair_frame(frame: np.ndarray, used: np.ndarray | None) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a frame (H, W) without faulty pixels, and its measured pixels: neither masked, nor faulty, nor saturated."""
    image = torch.as_tensor(np.ascontiguousarray(frame, np.float32))
    repaired, faults = repair(image)
    measured = repaired == image
    if used is not None:
        measured &= torch.from_numpy(used)
    if faults.saturated > 0.0:
        measured &= image < image.max()
    return repaired, measured


@dataclass(frozen=True)
class FrameCounts:
    """Counts of one frame on the binned grid (rows, columns).

    Attributes:
        values: counts, zero or more, as the likelihood of Poisson variables needs them.
        recorded: the same before read noise below zero was clipped.
        fitted: pixels that fits use.
        held_out: measured pixels that only the certificate uses.
        illumination: relative illumination of the wall, mean 1.
        background: expected counts of a binned pixel without light of the object, with what the clipping adds.
        signal: expected counts of a binned pixel by light of the object.
        roughness: relative variance of the expected counts of a binned pixel by the rough wall; see `change_background`.
    """

    values: torch.Tensor
    recorded: torch.Tensor
    fitted: torch.Tensor
    held_out: torch.Tensor
    illumination: torch.Tensor
    background: float
    signal: float
    roughness: float = 0.0

    def to(self, device: torch.device | str) -> FrameCounts:
        """Return the counts on a device."""
        moved = {name: value.to(device) for name, value in vars(self).items() if isinstance(value, torch.Tensor)}
        return replace(self, **moved)

    def change_background(self, background: float) -> FrameCounts:
        """Return the counts with another background. The roughness multiplies the light of the object only, so its effect on all counts
        is lowered by the ratio of the mean squares of signal (speckle) and counts.
        """
        total = self.signal + self.background
        signal = max(total - background, 1e-6)
        known = replace(self, background=background, signal=signal)
        return replace(known, roughness=self.roughness * 2.0 * signal**2 / known.mean_square)

    @property
    def mean_square(self) -> float:
        """Mean square of the expected counts, if the signal is speckle of contrast 1."""
        return 2.0 * self.signal**2 + 2.0 * self.signal * self.background + self.background**2


def read_counts(
    frame: np.ndarray,
    calibration: Calibration,
    grid: FieldGrid,
    rng: torch.Generator,
    uneven_patch: tuple[int, int] | None = None,
    used: np.ndarray | None = None,
) -> FrameCounts:
    """Return the counts of a frame, with all of the mean counted as signal.

    Args:
        used: pixels (H, W) that hold a measurement; None for all.
        uneven_patch: patch of the estimate if its illumination is uneven (`radiometry.estimation.illumination`).
    """
    repaired, known = repair_frame(frame, used)
    pixels = grid.binning[0] * grid.binning[1]
    electrons = repaired / calibration.gain + calibration.shift
    recorded = grid.bin(electrons.numpy())
    values = recorded.clamp_min(0.0)
    measured = grid.bin((~known).float().numpy()) == 0.0
    illumination = torch.ones(())
    if uneven_patch is not None:
        illumination = grid.bin(relative_illumination(electrons, uneven_patch).numpy()) / pixels
        measured &= illumination > MIN_ILLUMINATION
    held_out = measured & (torch.rand(values.shape, generator=rng) < HELD_OUT_FRACTION)
    if int(held_out.sum()) < MIN_HELD_OUT:
        found = f"{int(measured.sum())} in a frame, each of {grid.binning[0]} x {grid.binning[1]} camera pixels"
        expected = f"{round(MIN_HELD_OUT / HELD_OUT_FRACTION)} measured pixels or more for --method field"
        raise InputError("frames", expected, found, "provide larger frames or a smaller mask")
    mean, clipped = (float(part[measured].mean(dtype=torch.float64)) for part in (recorded, values))
    shift = pixels * max(calibration.shift, 0.0)
    signal, background = max(mean - shift, 1e-6), shift + clipped - mean
    fitted = measured & ~held_out
    return FrameCounts(values, recorded, fitted, held_out, illumination, background, signal, calibration.roughness / pixels)


def background_of(frames: Sequence[FrameCounts], variance_transfer: float, grains: float, modes: int = 1) -> float:
    """Return the background of a binned pixel, from the contrast of frames.

    The variance of the counts in excess of their noise is the squared signal times `variance_transfer` over the number of modes.

    Args:
        variance_transfer: fraction of the variance of the speckle that the camera transmits.
        grains: number of speckle grains per frame.
        modes: number of polarisations that share the light.
    """
    default = frames[0].background
    excess = []
    for one in frames:
        values = (one.recorded / one.illumination)[one.fitted].double()
        noise = float((one.recorded / one.illumination.square())[one.fitted].mean())
        noise += one.roughness * float(values.square().mean())
        square = (float(values.var()) - noise) * modes
        if square <= 0.0:  # no contrast is measurable, so it tells nothing
            return default
        clipped = float(((one.values - one.recorded) / one.illumination)[one.fitted].mean())
        excess.append(float(values.mean()) + clipped - (square / variance_transfer) ** 0.5)
    signal = float(np.mean([one.signal for one in frames]))
    error = 0.5 * signal * (KURTOSIS_FACTOR / (grains * len(frames))) ** 0.5
    found = float(np.mean(excess))
    return max(found, 0.0) if found - default > SIGNIFICANT_SIGMA * error else default
