"""Autocorrelation estimate of a capture or of a published image, with its origin."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.captured_frames import printable
from correlograph.files.drawing import SceneDrawing
from correlograph.files.file_frames import FileFrames
from correlograph.files.file_metadata import FileMetadata
from correlograph.files.images import read_autocorrelation
from correlograph.lags import LAGS, LagGrid, lag_grid_of
from invert.measure.contrast import Contrast, find_contrast
from invert.measure.lag_choice import choose_lags
from invert.measure.patch_fit import choose_patch_grid
from invert.measure.spectrum import Measurement, read_measurement
from invert.request import Request
from radiometry.autocorrelation import PITCH_M, PatchGrid, automatic_patch_size, patch_grid
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator, estimator_of
from radiometry.estimation.background import BackgroundRecord
from radiometry.estimation.masked import Kept
from radiometry.estimation.parallel_frames import PART_FRAMES, add_frames
from radiometry.estimation.published import PublishedEstimator
from radiometry.estimation.saved_sums import SavedSums
from radiometry.estimation.third_moment import FilteredFrames
from radiometry.transfer import gaussian_transfer, lag_transfer

FRAMES_FOR_CHOICE = 32
"""Number of frames for which pitch and number of lags are chosen, of a capture that is not kept in memory."""

MIN_BLUR_TRANSFER = 0.05
"""Minimum transfer of a known blur, two lags from zero."""

MAX_NEGATIVE_POWER_FRACTION = 0.2
"""Maximum fraction of an estimate's power in negative lags. Noise around a subtracted floor stays below it."""


@dataclass(frozen=True)
class EstimateRecord:
    """Origin of an estimate from frames, for result.json.

    Attributes:
        frames: number of frames.
        grid: layout of the patches in a frame, which determines the lags of the estimate.
        dof_expected: degrees of freedom K in theory.
        background: background and sensor faults in the frames.
        blur_found_pixels: standard deviation (rows, columns) of the blur that was estimated, if one was.
        lags_reason: why the estimate has these lags.
        file_metadata: metadata of the first file (`correlograph.files.file_metadata`).
        contrast: contrast of the speckle; None if it was not measured.
        object_number: number of the object among several that move, which the estimate shows alone; None if it shows all.
        needs_other_light: whether no possible blur lowers the contrast as far as measured.
    """

    frames: int
    grid: PatchGrid
    dof_expected: float
    background: BackgroundRecord
    blur_found_pixels: tuple[float, float] | None = None
    lags_reason: str = "chosen by the user"
    file_metadata: FileMetadata = field(default_factory=FileMetadata)
    contrast: Contrast | None = None
    object_number: int | None = None
    needs_other_light: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return the record for JSON."""
        grid = self.grid
        content: dict[str, Any] = {
            "frames": self.frames,
            "patches": {"size": grid.size, "width": grid.patch_shape[1], "rows": grid.rows, "columns": grid.columns},
            "lags": {"largest": grid.lags, "reason": self.lags_reason},
            "dof_expected": round(self.dof_expected, 1),
            "mean_model": self.background.as_dict(),
            "file_metadata": self.file_metadata.as_dict(),
        }
        if self.object_number is not None:
            content["object_number"] = self.object_number
        if self.contrast is not None:
            content["speckle_contrast"] = self.contrast.as_dict()
        return content if self.blur_found_pixels is None else content | {"blur_found_pixels": self.blur_found_pixels}


@dataclass(frozen=True)
class Estimate:
    """An estimate of r*r.

    Attributes:
        values: (127, 127), zero lag at [63, 63], noise floor included.
        quantisation: step of an estimate stored as integers; 0 for floating-point values.
        transfer: H of the camera per lag (127, 127); None if the camera is unknown.
        blur_pixels: standard deviation (rows, columns) of a Gaussian blur that `transfer` contains; None if unknown.
        path_blur_pixels: standard deviation (rows, columns) of the blur by the error of a path along which frames were added; `transfer`
            contains it.
        pitches_m: object distance of one lag along rows and columns; None if the camera is unknown.
        frame: first frame of the capture, for the report; None for published estimates.
        record: origin of the estimate; None for published estimates.
        drawing: drawing of the scene for the report; None for frames that were not rendered.
        filtered_frames: band-limited first frames for the third moment; None for published estimates.
        seconds: duration of the estimation.
    """

    name: str
    values: np.ndarray
    quantisation: float = 0.0
    transfer: np.ndarray | None = None
    blur_pixels: tuple[float, float] | None = None
    path_blur_pixels: tuple[float, float] = (0.0, 0.0)
    pitches_m: tuple[float, float] | None = None
    frame: np.ndarray | None = None
    record: EstimateRecord | None = None
    drawing: SceneDrawing | None = None
    filtered_frames: FilteredFrames | None = None
    seconds: float = 0.0

    @property
    def lag_grid(self) -> LagGrid:
        """Lags of the estimate."""
        return lag_grid_of(self.values)

    def __repr__(self) -> str:
        pitch = "unknown pitch" if self.pitches_m is None else f"{self.pitches_m[0] * 1e6:.0f} um per lag"
        return f"Estimate({self.name!r}, {self.values.shape[0]} x {self.values.shape[1]} lags, {pitch})"


def published_estimate(file: Path) -> Estimate:
    """Read a published autocorrelation image or array."""
    lags, quantisation = read_autocorrelation(file)
    name = printable(file.name)
    check_power(lags, name)
    return Estimate(name, lags, quantisation)


def check_power(lags: np.ndarray, name: str) -> None:
    """Refuse lags (127, 127) that cannot be a power spectrum, because their negative values are as strong as the others."""
    if not np.isfinite(lags).all():
        raise InputError("autocorrelation", "finite lags", f"NaN or infinity in {name}", "remove the file from the input")
    scaled = lags.astype(np.float64) / max(float(np.abs(lags).max()), 1e-300)
    below = float((scaled.clip(max=0.0) ** 2).sum())
    if below > MAX_NEGATIVE_POWER_FRACTION * float((scaled**2).sum()):
        raise InputError(
            "autocorrelation",
            "a power spectrum, zero or more at every lag",
            f"negative lags as strong as others in {name}",
            "provide the estimate with its noise floor, as it was measured",
        )


_Run = tuple[AutocorrelationEstimator | PublishedEstimator, np.ndarray]


def estimate_from_frames(capture: Capture, request: Request | None = None) -> Estimate:
    """Estimate r*r from frames, with the patch, lags, background model and known blur of a request."""
    request = request or Request()
    device, mean_model = request.device, request.mean_model
    begin = time.perf_counter()
    few = capture.frames[:FRAMES_FOR_CHOICE] if isinstance(capture.frames, FileFrames) else capture.frames

    def run_over(frames: Sequence[np.ndarray], tried: PatchGrid) -> _Run:
        estimator = estimator_of(tried, mean_model, device)
        with tqdm(total=len(frames), unit="frame", disable=None if frames is not few else True, leave=False) as bar:
            if isinstance(estimator, AutocorrelationEstimator) and len(frames) > PART_FRAMES and device == "cpu":
                kept = None if frames is few else request.sums_file
                saved = None if kept is None else SavedSums(kept)
                add_frames(estimator, frames, bar.update, saved, scheduler=None if frames is few else request.scheduler)
            else:
                for frame in frames:
                    estimator.add(frame)
                    bar.update(1)
        return estimator, estimator.estimate()

    @cache  # the grid that is chosen has already been tried
    def run_estimator(tried: PatchGrid) -> _Run:
        return run_over(few, tried)

    grid, reason = choose_grid(capture, request, lambda tried: run_estimator(tried)[1])
    estimator, values = run_estimator(grid) if few is capture.frames else run_over(capture.frames, grid)
    name = ", ".join(capture.names) or f"{len(capture.frames)} frames"
    estimate = estimate_of(estimator, values, capture.camera, name, capture.frames[0], reason)
    assert estimate.record is not None
    estimate = replace(
        estimate,
        record=replace(estimate.record, file_metadata=capture.file_metadata),
        drawing=SceneDrawing.from_json(capture.record.get("drawing")),
        seconds=time.perf_counter() - begin,
    )
    blur = request.known_blur
    return estimate if blur is None else apply_blur_transfer(estimate, (blur, blur))


def per_measured_pixel(estimate: Estimate, measured: np.ndarray) -> Estimate:
    """Return the estimate of frames that hold their mean where they were not measured, (H, W), as if they had been measured everywhere,
    with the degrees of freedom that are left."""
    if estimate.filtered_frames is None or estimate.record is None:
        return estimate
    record, contrast = estimate.record, estimate.record.contrast
    kept = Kept.of(measured, record.grid.patch_shape)
    if contrast is not None:
        contrast = Contrast(contrast.square / kept.power, contrast.error / kept.power / kept.patterns**0.5)
    return replace(
        estimate,
        values=(estimate.values / kept.power).astype(np.float32),
        record=replace(record, dof_expected=kept.patterns * record.dof_expected, contrast=contrast),
        filtered_frames=replace(estimate.filtered_frames, kept=kept),
    )


def choose_grid(capture: Capture, request: Request, values_on: Callable[[PatchGrid], np.ndarray]) -> tuple[PatchGrid, str]:
    """Return the grid of the lags that a request wants for a capture, and why.

    Args:
        values_on: returns the estimate on a grid.
    """

    def measure_on(tried: PatchGrid) -> Measurement:
        return read_measurement(values_on(tried))

    shape, geometry = (capture.frames[0].shape[0], capture.frames[0].shape[1]), capture.camera.lag_geometry
    patch, most = request.patch, request.lags or LAGS
    size = automatic_patch_size(shape, geometry, request.pitch_m or PITCH_M, most) if patch in (None, "fit") else patch
    grid = patch_grid(shape, size, most)
    if patch == "fit":
        grid = choose_patch_grid(grid, measure_on)
    elif (patch, request.lags, request.pitch_m) == (None, None, None):
        choice = choose_lags(grid, measure_on)
        return choice.grid, choice.reason
    return grid, "chosen by the user"


def estimate_of(
    estimator: AutocorrelationEstimator | PublishedEstimator,
    values: np.ndarray,
    camera: CameraMetadata,
    name: str,
    frame: np.ndarray,
    reason: str = "chosen by the user",
) -> Estimate:
    """Return the estimate that an estimator has computed (`values`), with its metadata; `frame` is an example of the frames."""
    grid, geometry, transfer, contrast = estimator.grid, camera.lag_geometry, camera_transfer(camera, estimator.grid), None
    if isinstance(estimator, AutocorrelationEstimator):
        mean_square = float(np.square(estimator.sums.levels).mean())
        contrast = find_contrast(read_measurement(values, transfer=transfer), grid, estimator.frames, mean_square)
    record = EstimateRecord(estimator.frames, grid, estimator.dof, estimator.background, lags_reason=reason, contrast=contrast)
    return Estimate(
        name=name,
        values=values,
        transfer=transfer,
        pitches_m=grid.lag_pitches_m(*geometry) if geometry else None,
        frame=frame,
        record=record,
        filtered_frames=None if isinstance(estimator, PublishedEstimator) else estimator.filtered_frames(),
    )


def apply_blur_transfer(estimate: Estimate, blur_pixels: tuple[float, float]) -> Estimate:
    """Include a Gaussian blur (rows, columns) in the transfer of an estimate from frames."""
    if estimate.record is None:
        raise ValueError("an estimate without frames has no patches")
    # The lags around zero keep nearly all of an object's light, so a blur that removes these leaves nothing to reconstruct.
    steps, zero = estimate.lag_grid.steps, estimate.lag_grid.lags
    blur = gaussian_transfer(steps, estimate.record.grid.patch_shape, blur_pixels)
    left = min(blur[zero, zero + 2], blur[zero + 2, zero])
    if left < MIN_BLUR_TRANSFER:
        found = f"{max(blur_pixels):g} pixels, which leaves {left:.2g} at two lags"
        raise InputError(
            "blur_pixels", "a blur that leaves light at lags next to zero", found, "correct the blur or focus the camera"
        )
    return replace(estimate, transfer=blur if estimate.transfer is None else estimate.transfer * blur, blur_pixels=blur_pixels)


def camera_transfer(camera: CameraMetadata, grid: PatchGrid) -> np.ndarray | None:
    """Return the transfer H of pupil and pixel at the lags of a grid; None if the camera is unknown."""
    if camera.lag_geometry is None or camera.pupil_diameter_m is None or camera.pupil_distance_m is None:
        return None
    return lag_transfer(
        grid.lag_grid.steps,
        grid.patch_shape,
        camera.pixel_pitch_m,
        camera.pupil_diameter_m,
        camera.wavelength_m,
        camera.pupil_distance_m,
    )
