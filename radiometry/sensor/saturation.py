"""Pixels that have their largest value, and photon-counting pixels that no longer tell light from more light."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import binom, gamma, norm, poisson

from radiometry.sensor.chain import stages_of
from radiometry.sensor.electronics import Electronics
from radiometry.sensor.photons import DarkCurrent
from radiometry.sensor.readout_noise import ReadoutNoise
from radiometry.sensor.stage import SpeckleLight

LEVELS = 2000
"""Number of equally probable levels of light over which a fraction is averaged."""

EXACT_ELECTRONS = 1e4
"""Largest number of electrons for which Poisson's distribution is not taken for a normal one."""


def saturated_fraction(light: SpeckleLight, electronics: Electronics) -> float:
    """Return the expected fraction of the pixels that have their largest value, by the full well or the ADC; 0 without either.

    The light of the object is distributed like the sum of `modes` exponentially distributed intensities (Goodman, Speckle Phenomena,
    section 3.3.2); lamps, stray light and dark current add their means. Blur by pupil and pixel, which lowers the contrast, is left out.
    """
    if not electronics.ceiling:
        return 0.0
    mean, least = _levels(light, electronics), electronics.ceiling - 0.5 * electronics.step
    readout = sum(stage.variance(light, electronics) for stage in stages_of(electronics) if isinstance(stage, ReadoutNoise))
    counts = binom(electronics.gates, -np.expm1(-mean / electronics.gates)) if electronics.gate else poisson(mean)
    if electronics.shot_noise and readout == 0.0 and least < EXACT_ELECTRONS:
        return float(counts.sf(math.ceil(least) - 1).mean())
    variance = readout + (counts.var() if electronics.shot_noise else 0.0)
    return float(norm.sf((least - counts.mean()) / np.sqrt(np.maximum(variance, 1e-12))).mean())


def counting_fraction(light: SpeckleLight, electronics: Electronics) -> float:
    """Return the expected fraction of the gates of a photon-counting camera that count a photon; 0 without gates."""
    return float(-np.expm1(-_levels(light, electronics) / electronics.gates).mean()) if electronics.gate else 0.0


def _levels(light: SpeckleLight, electronics: Electronics) -> np.ndarray:
    """Return equally probable means of the electrons of a pixel, (`LEVELS`,)."""
    constant = light.ambient + light.stray + DarkCurrent().mean(electronics)
    chances = (np.arange(LEVELS) + 0.5) / LEVELS
    return constant + light.signal / light.modes * gamma.ppf(chances, light.modes)
