"""Photons: dark current, shot noise, and the gates of a camera that counts single photons."""

from __future__ import annotations

import math

import numpy as np

from radiometry.sensor.electronics import Electronics
from radiometry.sensor.stage import SpeckleLight, Stage


class DarkCurrent(Stage):
    """Electrons that heat frees, with their own shot noise."""

    name = parameter = "dark_current"
    unit = "e/s"

    def record(self, electrons: np.ndarray, electronics: Electronics, rng: np.random.Generator) -> np.ndarray:
        return electrons + self.mean(electronics)

    def mean(self, electronics: Electronics) -> float:
        return electronics.dark_current * electronics.exposure_s

    def variance(self, light: SpeckleLight, electronics: Electronics) -> float:
        return self.mean(electronics)


class ShotNoise(Stage):
    """Poisson noise. Its variance, the mean of the light, is listed by source of the light (`NoiseTerms`)."""

    name = parameter = "shot_noise"

    def record(self, electrons: np.ndarray, electronics: Electronics, rng: np.random.Generator) -> np.ndarray:
        if electronics.gate or not electronics.shot_noise:
            return electrons
        return rng.poisson(electrons).astype(np.float32)


class PhotonCounting(Stage):
    """Gates in which a pixel counts at most one photon.

    A gate detects none with probability exp(-mean / gates), so counts are binomial and saturate at the number of gates. It receives
    x + c photons on average: x of the signal, Gamma-distributed over the pixels with mean mu and M modes, and a constant c. Moments of
    the counts follow from E[exp(-x)] = (1 + mu / M)^-M. In units of (r*r)(0) of these counts, their noise is
    (exp(c) (1 + mu) (1 + 2 mu) - (1 + mu)^2) / (mu^2 gates A) for M = 1.
    """

    name = "photon_counting"
    parameter = "gate"
    unit = "s"

    def record(self, electrons: np.ndarray, electronics: Electronics, rng: np.random.Generator) -> np.ndarray:
        detected = -np.expm1(-electrons / electronics.gates)
        if not electronics.shot_noise:
            return (electronics.gates * detected).astype(np.float32)
        return rng.binomial(int(electronics.gates), detected).astype(np.float32)

    def variance(self, light: SpeckleLight, electronics: Electronics) -> float:
        """Return the variance of the counts, in units of their peak and scaled to that of the light, beyond Poisson's."""
        mean, constant, each = self._per_gate(light, electronics)
        once = math.exp(-light.modes * math.log1p(each))
        noise = once * math.expm1(constant) - once * math.expm1(light.modes * (math.log1p(each) - math.log1p(2.0 * each)))
        counted = noise / self._spread(light, each) * (light.signal / light.modes) * (light.signal / electronics.gates)
        return counted - (mean + constant) * electronics.gates

    def shrinkage(self, light: SpeckleLight, electronics: Electronics) -> float:
        mean, constant, each = self._per_gate(light, electronics)
        return mean**2 / light.modes * math.exp(2.0 * constant) / self._spread(light, each)

    def _per_gate(self, light: SpeckleLight, electronics: Electronics) -> tuple[float, float, float]:
        """Return the mean photons of a gate from the signal, from all else, and from each mode of the signal."""
        mean = light.signal / electronics.gates
        dark = DarkCurrent().mean(electronics)
        return mean, (light.ambient + light.stray + dark) / electronics.gates, mean / light.modes

    def _spread(self, light: SpeckleLight, each: float) -> float:
        """Return the variance of exp(-x) over the pixels."""
        twice = math.exp(-light.modes * math.log1p(2.0 * each))
        # (1 + 2 a) / (1 + a)^2 = 1 - (a / (1 + a))^2
        return -twice * math.expm1(light.modes * math.log1p(-((each / (1.0 + each)) ** 2)))
