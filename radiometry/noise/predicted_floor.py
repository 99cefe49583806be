"""Contributions to the noise floor of a scene, predicted from its light and its sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

from radiometry.sensor import chain
from radiometry.sensor.electronics import Electronics
from radiometry.sensor.stage import SpeckleLight, Stage

LIGHT_TERMS = ("signal", "ambient", "other_light", "detector_speckle")
"""Contributions of the light itself; those of the sensor have the names of its stages."""


@dataclass(frozen=True)
class NoiseTerms:
    """Light and sensor of a frame, from which the noise of an estimate follows."""

    light: SpeckleLight
    electronics: Electronics

    @property
    def mean(self) -> float:
        """Mean electrons of a pixel."""
        dark = math.fsum(stage.mean(self.electronics) for stage in chain.stages_of(self.electronics))
        return self.light.signal + self.light.ambient + self.light.stray + dark

    def over_peak(self) -> dict[str, float | None]:
        """Return the contribution of each term to floor over peak; every value is None if the scene gives no signal.

        The peak (r*r)(0) of the estimate is signal^2 x grain_pixels. The subjective speckle of the virtual detector multiplies the
        signal by a pattern of relative variance 1 / M in a pixel. The mean square of fully developed speckle is 2 signal^2, so this adds
        2 / (M A_grain) of the peak at any exposure, on average over all lags. It is not quite white: pupil and pixel attenuate it at
        the outermost lags.
        """
        light = self.light
        white = [stage for stage in chain.CHAIN if stage.spread == "pixel"]
        if light.signal <= 0.0 or not math.isfinite(light.grain_pixels):
            return dict.fromkeys((*LIGHT_TERMS, *(stage.name for stage in white)), None)
        shares: dict[str, float | None] = {
            "signal": self._over_peak(light.signal),
            "ambient": self._over_peak(light.ambient),
            "other_light": self._over_peak(light.stray),
            "detector_speckle": 2.0 * light.detector_speckle / light.grain_pixels,
        }
        return shares | {stage.name: self.share(stage) for stage in white}

    def share(self, stage: Stage) -> float:
        """Return what a stage adds to floor over peak; for the noise of rows or columns, its variance in that unit."""
        if not stage.is_set(self.electronics) or self.light.signal <= 0.0:
            return 0.0
        return self._over_peak(stage.variance(self.light, self.electronics)) * self.shrinkage(stage)

    def shrinkage(self, end: Stage | None = None) -> float:
        """Return the ratio of the peak of the light to that of the recorded electrons, or of those that a stage receives."""
        stages = chain.stages_of(self.electronics)
        before = stages if end is None else stages[: stages.index(end)]
        return math.prod(stage.shrinkage(self.light, self.electronics) for stage in before)

    def floor_over_peak(self) -> float | None:
        """Return b / (r*r)(0) of all terms together."""
        shares = [share for share in self.over_peak().values() if share is not None]
        return math.fsum(shares) if shares else None

    def static_over_peak(self) -> float:
        """Return the part of floor over peak that is the same in all frames."""
        return math.fsum(self.share(stage) for stage in chain.stages_of(self.electronics) if stage.is_static)

    def _over_peak(self, variance: float) -> float:
        # two divisions, because the square of a faint signal would underflow
        return variance / self.light.signal / self.light.signal / self.light.grain_pixels


def estimate_error(signal_sum: float, signal_square_sum: float, lags: int, floor: float, dof: float) -> float:
    """Return the relative L2 error of an estimate after subtraction of the floor: sqrt(sum S^2 / (K sum A^2)), S = A + b.

    Args:
        signal_sum, signal_square_sum: sums of A = H (r*r) and of A^2 over the lags, A(0) = 1.
        lags: number of lags in the sums.
        floor: floor over peak.
    """
    total = signal_square_sum + 2.0 * floor * signal_sum + lags * floor**2
    return math.sqrt(total / (dof * signal_square_sum))
