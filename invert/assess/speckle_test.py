"""Consistency of the light with speckle of the reconstruction: third moment, and signal that the reconstruction leaves
unexplained."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.stats import norm

from invert.measure.estimate import Estimate
from invert.measure.spectrum import Measurement
from radiometry.autocorrelation import autocorrelate, smooth_by_window
from radiometry.estimation.frame_differences import frame_differences
from radiometry.estimation.third_moment import MIN_SIGNAL_FRACTION

UNEXPLAINED_FALSE_ALARMS = 0.01
"""Probability that noise alone raises the lower limit of the unexplained fraction above zero."""


@dataclass(frozen=True)
class SpeckleTest:
    """Consistency of frames and estimate with a reconstruction.

    Attributes:
        third_moment_ratio: third moment of the frames in units of that of speckle from the reconstruction: 1 for polarised light, 0.7 for
            unpolarised light, 0 for texture, much more for a specular highlight.
        error: its standard error.
        unexplained: relative L2 error of the reconstruction's r*r against the estimate, in excess of noise.
        unexplained_least: lower limit of `unexplained`; because of noise, the true value is below it with a probability of 1 %.
        part_differences: standard deviation of the signal's power between parts of a frame, relative to its mean and in excess of
            chance; 0 for speckle.
        part_chance: probability that speckle has `part_differences` at least as large.
        frame_differences: frame-to-frame standard deviation of the power at one lag, relative to its mean and in excess of
            noise.
        frame_chance: probability that frames of one object differ as much.
    """

    third_moment_ratio: float | None
    error: float | None
    unexplained: float
    unexplained_least: float = 0.0
    part_differences: float = 0.0
    part_chance: float = 1.0
    frame_differences: float = 0.0
    frame_chance: float = 1.0

    def as_dict(self) -> dict[str, float | None]:
        """Return the numbers for JSON, None for values that are not finite; `third_moment` is the old name of the ratio."""
        values = asdict(self) | {"third_moment": self.third_moment_ratio}
        return {name: value if value is not None and np.isfinite(value) else None for name, value in values.items()}

    @classmethod
    def from_dict(cls, values: dict[str, float | None] | None) -> SpeckleTest | None:
        """Return the test that `as_dict` described."""
        if values is None:
            return None
        chances = {name: values.get(name, 1.0) or 0.0 for name in ("part_chance", "frame_chance")}
        differences = {
            name: values.get(name) or 0.0
            for name in ("unexplained", "unexplained_least", "part_differences", "frame_differences")
        }
        return cls(values["third_moment_ratio"], values["error"], **differences, **chances)


def speckle_test(estimate: Estimate, measurement: Measurement, albedo: np.ndarray) -> SpeckleTest:
    """Test frames and estimate against a reconstruction (64, 64), not empty."""
    floor, ring, rings = measurement.noise.floor, measurement.noise.signal_ring, measurement.lag_grid.ring
    transfer = np.ones_like(estimate.values) if estimate.transfer is None else np.maximum(estimate.transfer, 0.05)
    signal = (measurement.values - floor) * transfer
    expected = smooth_by_window(autocorrelate(albedo)) * transfer
    seen = uniform_filter(np.where(rings < 2, 0.0, signal), 3).clip(0.0)
    weight = np.divide(seen, seen + floor, out=np.zeros_like(seen), where=seen > 0.0)
    weight[(ring < rings) | (rings < 2) | (weight < MIN_SIGNAL_FRACTION)] = 0.0
    weight = 0.5 * (weight + weight[::-1, ::-1])
    square = weight**2
    power = float((square * signal).sum() / max((square * expected).sum(), 1e-30))
    unexplained = unexplained_fraction(signal, expected, measurement, (ring >= rings) & (rings > 1))
    if estimate.filtered_frames is None or not weight.any() or power <= 0.0:
        return SpeckleTest(None, None, *unexplained)
    frames, noise = estimate.filtered_frames, measurement.noise
    likeness, error = frames.likeness(albedo, weight, np.sqrt(transfer), signal, floor, power)
    used = (ring >= rings) & (rings > 1) & measurement.lag_grid.half_plane
    between = frame_differences(frames, used, noise.inflation)
    return SpeckleTest(likeness, error, *unexplained, *frames.power_differences(weight, estimate.values), *between)


def unexplained_fraction(
    signal: np.ndarray, expected: np.ndarray, measurement: Measurement, used: np.ndarray
) -> tuple[float, float]:
    """Return the relative L2 error of an expected signal in excess of noise, and its lower limit.

    The scatter of the squared noise sets the limit: both signs of a lag carry the same noise, and the factor `inflation` of
    the variance accounts for the correlation of neighbouring lags.

    Args:
        signal, expected: signal of the estimate and of a reconstruction (127, 127). used: mask of the lags that count.
    """
    seen, model = signal[used].astype(np.float64), expected[used].astype(np.float64)
    total = float((seen**2).sum())
    if total == 0.0:
        return 0.0, 0.0
    noise = measurement.noise
    left = float(((seen - model * ((seen @ model) / max(model @ model, 1e-30))) ** 2).sum())
    variances = (seen + noise.floor) ** 2 / noise.dof if noise.dof else np.zeros_like(seen)
    scatter = 2.0 * math.sqrt(noise.inflation * float((variances**2).sum()))
    excess, power = left - float(variances.sum()), max(total - float(variances.sum()), 1e-3 * total)
    least = excess - norm.isf(UNEXPLAINED_FALSE_ALARMS) * scatter
    return math.sqrt(max(0.0, excess) / power), math.sqrt(max(0.0, least) / power)
