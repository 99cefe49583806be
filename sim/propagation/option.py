"""Task of a propagator, its predicted error and cost, and its settings."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from sim.propagation.sampling import Scatterers, Wall
from sim.propagation.validity import statistical_error

Precision = Literal["float32", "float64"]
PRECISIONS: tuple[Precision, ...] = ("float32", "float64")
Visibility = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""visible(tile_centres (t, 3), scatterers (n, 3)) -> transmitted amplitude (t, n); positions from the object's centre."""


@dataclass(frozen=True)
class Task:
    """A propagation and its required accuracy.

    Attributes:
        place, lag_m: see `validity.py`.
        accuracy: `statistical` or `field`.
        precisions: permitted precisions.
        leaves_lattice: whether the scatterers move to places outside a grid, which a single FFT cannot follow.
    """

    wall: Wall
    place: np.ndarray
    scatterers: Scatterers
    lag_m: float | tuple[float, float]
    accuracy: str
    tolerance: float
    precisions: tuple[Precision, ...] = PRECISIONS
    leaves_lattice: bool = False

    @cached_property
    def statistical_error(self) -> float:
        """Statistical error, equal for `fraunhofer` and `fresnel`, which give every scatterer a position in a flat plane."""
        return statistical_error(self.wall, self.place, self.scatterers, self.lag_m)


@dataclass(frozen=True)
class Option:
    """One propagator in one precision, with its predicted error, seconds and bytes per frame; `why` is a remark for the plan.

    `patches` is the division of the wall into patches that `nufft` has planned; other propagators do not use it.
    """

    propagator: str
    precision: Precision
    predicted_error: float
    seconds: float
    bytes: int
    why: str
    patches: Any = None

    def as_dict(self) -> dict[str, Any]:
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in asdict(self).items()
            if name != "patches"
        }


@dataclass(frozen=True)
class Terms:
    """Settings of a propagator; each uses those that it needs.

    Attributes:
        tolerance, patches: used by nufft only; if `patches` is None, they are planned for `tolerance`.
        visible: transmission past occluders; None if nothing occludes.
    """

    precision: Precision = "float64"
    tolerance: float = 1e-6
    patches: Any = None
    device: str = "cpu"
    visible: Visibility | None = None
