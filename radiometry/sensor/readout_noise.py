"""Noise of the readout: of each pixel, of whole rows and columns, and the sensor's fixed pattern."""

from __future__ import annotations

import numpy as np

from radiometry.sensor.electronics import Electronics
from radiometry.sensor.stage import SpeckleLight, Stage

CAMERA = 20200107
"""Seed of the fixed pattern, which all frames of a camera share."""


class ReadoutNoise(Stage):
    """Normal noise whose standard deviation is the parameter."""

    def variance(self, light: SpeckleLight, electronics: Electronics) -> float:
        return getattr(electronics, self.parameter) ** 2

    def record(self, electrons: np.ndarray, electronics: Electronics, rng: np.random.Generator) -> np.ndarray:
        rows, columns = electrons.shape
        shape = {"pixel": (rows, columns), "row": (rows, 1), "column": (1, columns)}[self.spread]
        electrons += np.float32(getattr(electronics, self.parameter)) * rng.standard_normal(shape, np.float32)
        return electrons


class ReadNoise(ReadoutNoise):
    """Noise of the amplifier."""

    name = parameter = "read_noise"


class RowNoise(ReadoutNoise):
    """An offset of each row, independent in each frame."""

    name = parameter = "row_noise"
    spread = "row"


class ColumnNoise(ReadoutNoise):
    """An offset of each column, independent in each frame."""

    name = parameter = "column_noise"
    spread = "column"


class FixedPattern(ReadoutNoise):
    """Dark-signal non-uniformity: an offset of each pixel, equal in all frames."""

    name = parameter = "fixed_pattern"
    is_static = True

    def record(self, electrons: np.ndarray, electronics: Electronics, rng: np.random.Generator) -> np.ndarray:
        return super().record(electrons, electronics, np.random.default_rng(CAMERA))
