"""Public functions of the radiometry: light budget and prediction of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from correlograph.errors import InputError
from correlograph.ranges import FRAMES, PATCH
from radiometry.light_budget_rows import Budget
from radiometry.light_budget_rows import light_budget as budget_of_path
from radiometry.prediction import predict as predict_geometry


@dataclass(frozen=True)
class Forecast:
    """Prediction of the autocorrelation estimate of a capture.

    Attributes:
        signal: H (r*r), smoothed by the window, (127, 127), in units of (r*r)(0).
        floor_over_peak: noise floor in the same unit; None without light.
        dof: degrees of freedom K.
        signal_to_noise: signal-to-noise ratio of the estimate, averaged over the lags of the object; None without light.
        pitches_m: object distance of one lag along rows and columns.
    """

    signal: np.ndarray
    floor_over_peak: float | None
    dof: float
    signal_to_noise: float | None
    pitches_m: tuple[float, float]


def light_budget(scene: Any) -> Budget:
    """Return the light budget of a scene.

    Args:
        scene: from `correlograph.load`, or its geometry.

    Raises InputError for anything else than a scene.
    """
    return budget_of_path(_geometry_of(scene).light_path)


def predict(scene: Any, frames: int = 2, patch: int | None = None) -> Forecast:
    """Predict the estimate of a capture with a number of frames and patches of `patch` pixels (None: as in `invert`).

    Raises InputError for numbers out of range, and for anything else than a scene.
    """
    frames = FRAMES.check("frames", frames)
    patch = None if patch is None else PATCH.check("patch", patch)
    known = predict_geometry(_geometry_of(scene), patch)
    return Forecast(
        known.signal, known.floor_over_peak(frames), known.dof(frames), known.signal_to_noise(frames), known.pitches_m
    )


def _geometry_of(scene: Any) -> Any:
    geometry = getattr(scene, "geometry", scene)
    if not hasattr(geometry, "light_path"):
        raise InputError("scene", "a loaded scene", f"{scene!r:.60}", "load it with correlograph.load")
    return geometry
