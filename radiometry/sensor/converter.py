"""The pixel's full well and the converter (ADC)."""

from __future__ import annotations

import numpy as np

from radiometry.sensor.electronics import Electronics
from radiometry.sensor.stage import SpeckleLight, Stage


class FullWell(Stage):
    """Saturation of a pixel. The prediction of the noise omits it; the plan warns if more than a thousandth of the pixels saturate."""

    name = parameter = "full_well"

    def record(self, electrons: np.ndarray, electronics: Electronics, rng: np.random.Generator) -> np.ndarray:
        # An ADC with offset keeps read noise below zero; only the top is clipped.
        return np.minimum(electrons, np.float32(electronics.full_well), out=electrons)


class Quantisation(Stage):
    """Rounding to digital numbers."""

    name = "quantisation"
    parameter = "bits"
    unit = "bits"

    def record(self, electrons: np.ndarray, electronics: Electronics, rng: np.random.Generator) -> np.ndarray:
        step = np.float32(electronics.step)
        return np.minimum(np.round(electrons / step), np.float32(2**electronics.bits - 1)) * step

    def variance(self, light: SpeckleLight, electronics: Electronics) -> float:
        return electronics.step**2 / 12.0
