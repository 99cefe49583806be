"""Consistency of the light with speckle of the reconstruction: third moment, and signal that the reconstruction leaves
unexplained."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.stats import norm

from invert.assess.doubts import FALSE_ALARMS_EACH
from invert.measure.estimate import Estimate
from invert.measure.spectrum import Measurement
from radiometry.autocorrelation import autocorrelate, smooth_by_window
from radiometry.estimation.excess_scatter import ExcessScatter
from radiometry.estimation.frame_differences import frame_differences
from radiometry.estimation.third_moment import MIN_SIGNAL_FRACTION

ALLOWED_PART_DIFFERENCES = 0.25
"""Relative differences of the power between parts of a frame that uneven light explains."""

ALLOWED_FRAME_DIFFERENCES = 0.1
"""Relative differences of the power between frames that errors of the noise model and changes of focus explain."""

ALLOWED_UNEXPLAINED_FRACTION = 0.35
"""Fraction of the signal that a reconstruction may leave unexplained."""


@dataclass(frozen=True)
class SpeckleTest:
    """Consistency of frames and estimate with a reconstruction.

    Attributes:
        third_moment_ratio: third moment of the frames in units of that of speckle from the reconstruction: 1 for polarised light, 0.7 for
            unpolarised light, 0 for texture, much more for a specular highlight.
        error: its standard error.
        unexplained: relative L2 error of the reconstruction's r*r against the estimate, in excess of noise.
        part_differences: standard deviation of the signal's power between parts of a frame, relative to its mean and in excess of
            chance; 0 for speckle.
        frame_differences: frame-to-frame standard deviation of the power at one lag, relative to its mean and in excess of
            noise.
        unexplained_threshold, part_threshold, frame_threshold: values that these exceed with the probability `FALSE_ALARMS_EACH` if
            as much as is allowed is wrong.
    """

    third_moment_ratio: float | None
    error: float | None
    unexplained: float
    unexplained_threshold: float = math.inf
    part_differences: float = 0.0
    part_threshold: float = math.inf
    frame_differences: float = 0.0
    frame_threshold: float = math.inf

    def as_dict(self) -> dict[str, float | None]:
        """Return the numbers for JSON, None for values that are not finite; `third_moment` is the old name of the ratio."""
        values = asdict(self) | {"third_moment": self.third_moment_ratio}
        return {name: value if value is not None and np.isfinite(value) else None for name, value in values.items()}

    @classmethod
    def from_dict(cls, values: dict[str, float | None] | None) -> SpeckleTest | None:
        """Return the test that `as_dict` described; thresholds that are missing are infinite."""
        if values is None:
            return None
        thresholds = {
            name: math.inf if (value := values.get(name)) is None else float(value)
            for name in ("unexplained_threshold", "part_threshold", "frame_threshold")
        }
        differences = {
            name: float(values.get(name) or 0.0) for name in ("unexplained", "part_differences", "frame_differences")
        }
        return cls(values["third_moment_ratio"], values["error"], **differences, **thresholds)


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
    parts = _judge(frames.power_differences(weight, estimate.values, signal, albedo), ALLOWED_PART_DIFFERENCES)
    between = _judge(frame_differences(frames, used, noise.inflation), ALLOWED_FRAME_DIFFERENCES)
    return SpeckleTest(likeness, error, *unexplained, *parts, *between)


def _judge(scatter: ExcessScatter | None, allowed: float) -> tuple[float, float]:
    """Return a scatter and its threshold."""
    return (0.0, math.inf) if scatter is None else (scatter.relative, scatter.threshold(allowed, FALSE_ALARMS_EACH))


def unexplained_fraction(
    signal: np.ndarray, expected: np.ndarray, measurement: Measurement, used: np.ndarray
) -> tuple[float, float]:
    """Return the relative L2 error of an expected signal in excess of noise, and its threshold.

    The scatter of the squared noise sets the threshold: both signs of a lag carry the same noise, and the factor `inflation` of
    the variance accounts for the correlation of neighbouring lags.

    Args:
        signal, expected: signal of the estimate and of a reconstruction (127, 127).
        used: mask of the lags that count.
    """
    seen, model = signal[used].astype(np.float64), expected[used].astype(np.float64)
    total = float((seen**2).sum())
    if total == 0.0:
        return 0.0, math.inf
    noise = measurement.noise
    left = float(((seen - model * ((seen @ model) / max(model @ model, 1e-30))) ** 2).sum())
    variances = (seen + noise.floor) ** 2 / noise.dof if noise.dof else np.zeros_like(seen)
    scatter = 2.0 * math.sqrt(noise.inflation * float((variances**2).sum()))
    excess, power = left - float(variances.sum()), max(total - float(variances.sum()), 1e-3 * total)
    by_chance = float(norm.isf(FALSE_ALARMS_EACH)) * scatter / power
    return math.sqrt(max(0.0, excess) / power), math.sqrt(ALLOWED_UNEXPLAINED_FRACTION**2 + by_chance)
