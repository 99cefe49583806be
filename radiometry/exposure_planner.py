"""Division of an exposure into frames and patches for the lowest error of the estimate.

Metzler et al. 2020, section 4.B ("Goldilocks zone"): a few long exposures give too few samples (small K), and many short ones
hide each in shot noise (high floor over peak). Smaller patches give more samples, but a coarser lag pitch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from correlograph.errors import InputError, check_positive
from correlograph.lags import LAG_SIDE, OBJECT_SIDE
from radiometry.field_forecast import MAX_FIELD_FRAMES, FieldForecast
from radiometry.noise.measured_noise import fit_known_signal
from radiometry.prediction import Prediction, predict

FRAME_COUNTS = (2, 3, 4, 5, 7, *(round(10 * 2 ** (half / 2)) for half in range(34)))
"""Numbers of frames in half octaves, up to a million."""

RELATIVE_TOLERANCE = 0.02
"""Plans whose predicted error is within this fraction of the lowest count as equal; the one with the fewest frames is chosen."""


@dataclass(frozen=True)
class Division:
    """One division of the exposure, with the predicted relative L2 error of the estimate after subtraction of the floor."""

    frames: int
    exposure_s: float
    patch: int
    patches: int
    pitch_m: float
    floor_over_peak: float
    dof: float
    error: float
    fields: FieldForecast | None = None


def divide(
    geometry: Any, budget_s: float, resolution_m: float = 300e-6, counts: tuple[int, ...] = FRAME_COUNTS
) -> list[Division]:
    """Return divisions of `budget_s` seconds of exposure into `counts` frames, fewest first.

    Args:
        geometry: geometry of the scene; its own exposure is ignored.
        resolution_m: required lag pitch; the patch size with the closest pitch is used.

    Raises InputError for an exposure that is not positive, a scene without light, or an object wider than 64 lags.
    """
    check_positive("--budget-s", budget_s)
    prediction = _predict_at_resolution(geometry, resolution_m)
    gate, divisions = geometry.camera.electronics.gate, []
    for frames in counts:
        if budget_s / frames < gate:
            break
        divisions.append(_division(prediction, frames, budget_s / frames))
    if not divisions:
        raise InputError("--budget-s", f"at least {counts[0]} gates of {gate:g} s", budget_s, "raise the budget")
    return divisions


def divide_for_fields(geometry: Any, resolution_m: float) -> Division:
    """Return the fewest frames whose fields resolve a half-period before despeckling, at the shortest exposure that suffices for each.

    Raises InputError if no exposure suffices, or if `MAX_FIELD_FRAMES` frames do not resolve it.
    """
    check_positive("--fields-m", resolution_m)
    prediction = predict(geometry)
    exposure_s = prediction.fields_exposure_s()
    if exposure_s is None:
        raise InputError(
            "scene",
            "light, a grain of two pixels and an object narrower than the lags, for fields",
            "none or too little",
            "see python -m sim --plan",
        )
    resolved = {frames: prediction.speckled.half_period_m(frames) for frames in range(1, MAX_FIELD_FRAMES + 1)}
    frames = next((frames for frames, half_period_m in resolved.items() if half_period_m <= resolution_m), None)
    if frames is None:
        finest_m = resolved[MAX_FIELD_FRAMES]
        raise InputError(
            "--fields-m", f"{finest_m:.3g} m or coarser in this scene", resolution_m, "increase it or widen the frame"
        )
    return _division(prediction, frames, exposure_s)


def _division(prediction: Prediction, frames: int, exposure_s: float) -> Division:
    """Predict a division of the exposure. Raises InputError for a scene without light."""
    divided, grid = prediction.at_exposure(exposure_s), prediction.grid
    floor, error = divided.floor_over_peak(frames), divided.error(frames)
    if floor is None or error is None:
        raise InputError("scene", "light from the hidden object", "none", "raise power or albedo")
    dof, fields = divided.dof(frames), divided.forecast_fields(frames)
    return Division(frames, exposure_s, grid.size, grid.count, prediction.pitch_m, floor, dof, error, fields)


def _predict_at_resolution(geometry: Any, resolution_m: float) -> Prediction:
    """Predict the estimate with the required lag pitch. Raises InputError if frame or object do not permit it."""
    check_positive("--resolution-m", resolution_m)
    optics = (geometry.wavelength_m, geometry.distance_m, geometry.seen_pitch_m[0])
    smallest = int(np.ceil(optics[0] * optics[1] / (resolution_m * optics[2]) - 0.5))
    shorter = min(geometry.camera.frame_shape)
    if smallest > shorter // 2:
        raise InputError(
            "--resolution-m",
            f"{2 * optics[0] * optics[1] / (shorter * optics[2]):.3g} m or coarser in this scene",
            resolution_m,
            "increase --resolution-m or move the wall closer",
        )
    prediction = predict(geometry, max(smallest, LAG_SIDE))
    for widest, pitch_m in zip(geometry.hidden_object.extent_m, prediction.pitches_m, strict=True):
        if widest > OBJECT_SIDE * pitch_m:
            raise InputError(
                "--resolution-m",
                f"{widest / OBJECT_SIDE:.3g} m or coarser, for the object to fit {OBJECT_SIDE} lags",
                resolution_m,
                "increase --resolution-m",
            )
    return prediction


def best(divisions: list[Division]) -> Division:
    """Return the division with the fewest frames whose error is within 2 % of the lowest."""
    least = min(division.error for division in divisions)
    return next(division for division in divisions if division.error <= (1.0 + RELATIVE_TOLERANCE) * least)


def measured_error(estimate: np.ndarray, prediction: Prediction) -> float:
    """Return the relative error of an estimate against the known r*r, with fitted floor and least-squares gain, over the same
    lags; infinite for a gain of zero. Raises InputError for an estimate of zeros, as of frames without a single photoelectron."""
    half = prediction.grid.lag_grid.half_plane
    if not estimate[half].any():
        raise InputError("--check", "photoelectrons in the rendered frames", "none", "raise --budget-s, or leave out --check")
    _, floor = fit_known_signal(estimate, prediction.signal)
    seen, signal = estimate[half] - floor, prediction.signal[half]
    gain = (seen @ signal) / (signal @ signal)
    scale = abs(gain) * np.linalg.norm(signal)
    return float(np.linalg.norm(seen - gain * signal) / scale) if scale else np.inf
