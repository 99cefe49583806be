"""A kernel's task, its predicted error and cost, and the settings it runs with."""

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
"""visible(tile_centres (t, 3), scatterers (n, 3)) -> amplitude that passes (t, n), places from the object's centre."""


@dataclass(frozen=True)
class Task:
    """What is to be propagated, and how well.

    Attributes:
        place, lag_m: see `validity.py`.
        accuracy: `statistical` or `field`.
        precisions: that may be used.
    """

    wall: Wall
    place: np.ndarray
    scatterers: Scatterers
    lag_m: float | tuple[float, float]
    accuracy: str
    tolerance: float
    precisions: tuple[Precision, ...] = PRECISIONS

    @cached_property
    def statistical_error(self) -> float:
        """The same for all kernels that assume a flat object's directions."""
        return statistical_error(self.wall, self.place, self.scatterers, self.lag_m)


@dataclass(frozen=True)
class Option:
    """One kernel in one precision, with its predicted error, seconds and bytes for a frame; `why` where it cannot be had.

    `patches` are those of nufft.
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
    """Settings of a kernel; each uses those it needs.

    Attributes:
        tolerance, patches: of nufft; patches are found afresh for the tolerance where None.
        visible: what occluders let pass; everything where None.
        progress: called with the number of parts done.
    """

    precision: Precision = "float64"
    tolerance: float = 1e-6
    patches: Any = None
    device: str = "cpu"
    visible: Visibility | None = None
    progress: Callable[[int], object] = lambda parts: None
