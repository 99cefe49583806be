"""The autocorrelation estimate that retrieval starts from, with what is known about its origin."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import CameraFacts, Capture
from correlograph.files.images import read_autocorrelation
from correlograph.lags import LAG_SIDE, LAGS
from correlograph.ranges import BLUR, Range
from invert.measure.capture import printable
from invert.measure.patch_fit import fitting_grid
from invert.measure.spectrum import read_measurement
from radiometry.autocorrelation import PatchGrid, automatic_patch_size, patch_grid
from radiometry.estimation.published import PublishedEstimator
from radiometry.estimation.third_moment import FilteredFrames
from radiometry.estimation.whole_frames import AutocorrelationEstimator, Mean, estimator_of
from radiometry.transfer import gaussian_transfer, lag_transfer

Patch = int | Literal["fit"] | None
"""Patch size in pixels, or how it is chosen; see `estimate_from_frames`."""

PATCH = Range(LAG_SIDE, 2**31 - 1)

LARGEST_BELOW = 0.2
"""Share of an estimate's power that lags below zero may have."""


@dataclass(frozen=True)
class Estimate:
    """An estimate (127, 127), zero lag at [63, 63], floor included.

    Attributes:
        quantisation: step of an estimate stored as integers, 0 for none.
        transfer: H of the camera per lag (127, 127), None where the camera is unknown.
        blur_pixels: standard deviation of a Gaussian blur, down and right, that `transfer` holds; None where it is unknown.
        pitches_m: object distance of one lag down and right, None where the camera is unknown.
        frame: first frame of the capture, for the report; None for published estimates.
        facts: how the frames were cut, for result.json.
        filtered_frames: of the first frames, what tells speckle from other light; None for published estimates.
        seconds: time that the autocorrelation took.
    """

    name: str
    lags: np.ndarray
    quantisation: float = 0.0
    transfer: np.ndarray | None = None
    blur_pixels: tuple[float, float] | None = None
    pitches_m: tuple[float, float] | None = None
    frame: np.ndarray | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    filtered_frames: FilteredFrames | None = None
    seconds: float = 0.0


def published_estimate(file: Path) -> Estimate:
    """An autocorrelation picture or array, as it is."""
    lags, quantisation = read_autocorrelation(file)
    name = printable(file.name)
    check_power(lags, name)
    return Estimate(name, lags, quantisation)


def check_power(lags: np.ndarray, name: str) -> None:
    """Refuse lags (127, 127) that are no power spectrum: negative ones as strong as others, not just noise about no floor."""
    if not np.isfinite(lags).all():
        raise InputError("autocorrelation", "finite lags", f"NaN or infinity in {name}", "leave it out")
    scaled = lags.astype(np.float64) / max(float(np.abs(lags).max()), 1e-300)
    below = float((scaled.clip(max=0.0) ** 2).sum())
    if below > LARGEST_BELOW * float((scaled**2).sum()):
        raise InputError("autocorrelation", "a power spectrum, zero or more at every lag",
                         f"negative lags as strong as others in {name}", "give the estimate with its floor, as it was measured")


def estimate_from_frames(capture: Capture, patch: Patch, device: str, mean: Mean = "auto",
                         blur_pixels: float | None = None) -> Estimate:
    """Estimate r*r from frames.

    Args:
        mean: which mean of the frames is subtracted; see `radiometry.estimation.whole_frames`.
        patch: patch size in pixels; None chooses it from the lag pitch wanted (300 um), or takes an
            eighth of the frame where the camera is unknown; "fit" begins there and goes on to what suits the object
            (`invert.measure.patch_fit`).
        blur_pixels: standard deviation of a Gaussian blur beyond pupil and pixel, where it is known; 0 for none.
    """
    if blur_pixels is not None:
        BLUR.check("--blur-pixels", blur_pixels)
    begin = time.perf_counter()
    geometry = capture.camera.lag_geometry
    shape = (capture.frames[0].shape[0], capture.frames[0].shape[1])
    by_itself = patch is None or patch == "fit"
    grid = patch_grid(shape, automatic_patch_size(shape, geometry) if by_itself else PATCH.check("patch", patch))

    @cache  # the grid that fits has been tried
    def estimated(tried: PatchGrid) -> tuple[AutocorrelationEstimator | PublishedEstimator, np.ndarray]:
        estimator = estimator_of(tried, mean, device)
        for frame in capture.frames:
            estimator.add(frame)
        return estimator, estimator.estimate()

    if patch == "fit":
        grid = fitting_grid(grid, lambda tried: read_measurement(estimated(tried)[1]))
    estimator, lags = estimated(grid)
    estimate = Estimate(
        name=", ".join(capture.names) or f"{len(capture.frames)} frames",
        lags=lags,
        transfer=_camera_transfer(capture.camera, grid.patch_shape),
        pitches_m=grid.lag_pitches_m(*geometry) if geometry else None,
        frame=capture.frames[0],
        facts={
            "frames": len(capture.frames),
            "patches": {"size": grid.size, "width": grid.patch_shape[1], "rows": grid.rows, "columns": grid.columns},
            "dof_expected": round(estimator.dof, 1),
            "mean_model": estimator.facts,
        },
        filtered_frames=None if isinstance(estimator, PublishedEstimator) else estimator.filtered_frames(),
        seconds=time.perf_counter() - begin,
    )
    return estimate if blur_pixels is None else blurred(estimate, (blur_pixels, blur_pixels))


def blurred(estimate: Estimate, blur_pixels: tuple[float, float]) -> Estimate:
    """An estimate from frames without a known blur, as that of frames with a Gaussian one (down, right)."""
    patches = estimate.facts["patches"]
    blur = gaussian_transfer(np.arange(-LAGS, LAGS + 1), (patches["size"], patches["width"]), blur_pixels)
    return replace(estimate, transfer=blur if estimate.transfer is None else estimate.transfer * blur, blur_pixels=blur_pixels)


def _camera_transfer(facts: CameraFacts, patch_shape: tuple[int, int]) -> np.ndarray | None:
    if facts.lag_geometry is None or facts.pupil_diameter_m is None or facts.pupil_distance_m is None:
        return None
    return lag_transfer(np.arange(-LAGS, LAGS + 1), patch_shape, facts.pixel_pitch_m, facts.pupil_diameter_m,
                        facts.wavelength_m, facts.pupil_distance_m)
