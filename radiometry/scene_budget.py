"""Public API of the radiometry: the light budget of a scene, and what its frames will show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from radiometry.prediction import predict as predict_geometry
from radiometry.throughput import Budget
from radiometry.throughput import light_budget as budget_of_path


@dataclass(frozen=True)
class Forecast:
    """What the autocorrelation estimate of a capture will hold.

    Attributes:
        signal: H (r*r), window-smoothed, (127, 127), in units of (r*r)(0).
        floor_over_peak: noise floor in the same unit; None without light.
        dof: degrees of freedom K.
        signal_to_noise: mean over the object's lags; None without light.
        pitches_m: object distance of one lag, down and right.
    """

    signal: np.ndarray
    floor_over_peak: float | None
    dof: float
    signal_to_noise: float | None
    pitches_m: tuple[float, float]


def light_budget(scene: Any) -> Budget:
    """The light budget that a scene's frames follow.

    Args:
        scene: from `sim.load`, or its geometry.
    """
    return budget_of_path(getattr(scene, "geometry", scene).light_path)


def predict(scene: Any, frames: int = 2, patch: int | None = None) -> Forecast:
    """What a capture of so many frames will show, cut into patches of `patch` pixels (None: as `invert` would)."""
    known = predict_geometry(getattr(scene, "geometry", scene), patch)
    terms = known.terms
    return Forecast(known.signal, terms.floor_over_peak(), known.dof(frames), known.signal_to_noise(frames), known.pitches_m)
