"""A stage of the sensor, and the light that it receives."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from correlograph.errors import InputError
from radiometry.sensor.electronics import Electronics


@dataclass(frozen=True)
class SpeckleLight:
    """Light that a pixel receives in one frame, in photoelectrons.

    Attributes:
        signal: mean photoelectrons from the hidden object.
        grain_pixels: coherence area of its speckle in pixels, infinite without an object.
        ambient: mean photoelectrons from lamps and other emitters.
        stray: mean photoelectrons of the laser's light by other ways.
        detector_speckle: relative variance 1 / M of the subjective speckle of the virtual detector in a pixel, times the fraction of
            the mean square that remains with motion and depolarisation; 0 if it is omitted.
        modes: number of incoherent speckle patterns of equal power that share the signal; not necessarily a whole number.

    Raises InputError for a negative value, and for one that is not finite.
    """

    signal: float
    grain_pixels: float
    ambient: float = 0.0
    stray: float = 0.0
    detector_speckle: float = 0.0
    modes: float = 1.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            legal = value > 0.0 if name == "grain_pixels" else 0.0 <= value < math.inf
            if not legal:
                raise InputError(name, "a finite mean, area or number, zero or more", value, f"correct {name}")


class Stage:
    """One stage. The defaults are those of a stage that adds neither electrons nor noise.

    Attributes:
        name: name of the effect in the plan.
        parameter: attribute of `Electronics` that enables the stage.
        unit: unit of that parameter.
        spread: part of a frame that shares one random value: a pixel, a row or a column.
        is_static: whether the noise is the same in all frames. With two frames or more, `invert` subtracts what they share.
    """

    name: str
    parameter: str
    unit = "e"
    spread: Literal["pixel", "row", "column"] = "pixel"
    is_static = False

    def is_set(self, electronics: Electronics) -> bool:
        """Return whether the camera has this stage."""
        return bool(getattr(electronics, self.parameter))

    def record(self, electrons: np.ndarray, electronics: Electronics, rng: np.random.Generator) -> np.ndarray:
        """Return the electrons (H, W) after this stage, sampled; the array may be changed in place."""
        raise NotImplementedError

    def mean(self, electronics: Electronics) -> float:
        """Return the electrons that the stage adds to a pixel on average."""
        return 0.0

    def variance(self, light: SpeckleLight, electronics: Electronics) -> float:
        """Return the variance that the stage adds to a pixel, in electrons squared."""
        return 0.0

    def shrinkage(self, light: SpeckleLight, electronics: Electronics) -> float:
        """Return the ratio of the peak (r*r)(0) before this stage to that after it."""
        return 1.0
