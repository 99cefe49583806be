"""The one path from a source to a result: read, estimate, find an unknown blur, reconstruct, assess."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from numbers import Integral, Real
from pathlib import Path
from typing import Literal

import numpy as np

from correlograph.errors import InputError, check_device
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.captured_frames import check_frame, describe_files, read_capture, stray_light_of
from correlograph.files.corrections import Corrections
from correlograph.files.file_frames import FileFrames
from correlograph.files.images import check_symmetry
from correlograph.files.output import path_of
from correlograph.files.stacks import open_stack
from correlograph.lags import LAG_SIDE
from correlograph.ranges import LAG_COUNT, SEED
from correlograph.workers import check_scheduler
from invert.assess.reliability import assess_reliability, describe_limits, has_shifted, is_speckle
from invert.assess.speckle_test import speckle_test
from invert.blur_fit import estimate_blur, likelihood_before_division
from invert.choices import (
    BALANCED,
    FAST,
    FIELD,
    UNET,
    Method,
    Quality,
    check_mean_model,
    method_named,
    quality_named,
    retrieves_fields,
)
from invert.field.reconstruction import FieldReconstruction
from invert.field.retrieval import retrieve_fields
from invert.measure.estimate import Estimate, Patch, check_power, estimate_from_frames, published_estimate
from invert.measure.preparation import mean_frame, prepare
from invert.measure.spectrum import Measurement, read_measurement
from invert.methods import Reconstruction, reconstruct_measurement
from invert.output.result import Result, Settings
from invert.solvers.base import Progress, no_progress
from invert.tracking.travel import find_travel
from radiometry.field_forecast import forecast_fields

Source = Capture | Estimate | str | Path | Sequence[str | Path] | np.ndarray | Sequence[np.ndarray]

Blur = float | Literal["auto"] | None
"""Standard deviation of a Gaussian blur in pixels, "auto" to estimate it, or None for the default of the method."""


def reconstruct(
    source: Source,
    *,
    method: str | Method = UNET,
    quality: str | Quality = BALANCED,
    patch: Patch = None,
    lags: int | None = None,
    pitch_m: float | None = None,
    camera: CameraMetadata | None = None,
    corrections: Corrections | None = None,
    blur_pixels: Blur = None,
    mean_model: str = "auto",
    weights: str | Path | None = None,
    seed: int = 0,
    device: str = "cpu",
    autocorrelation: bool | None = None,
    sums_file: str | Path | None = None,
    scheduler: str | None = None,
    progress: Progress = no_progress,
) -> Result:
    """Reconstruct the albedo of the hidden object.

    Args:
        source: a capture; a frame file, several, or a folder of them; frames (n, H, W) or (H, W); an estimate; or a published
            autocorrelation, as a file or an array of 127 x 127 lags (an array may have 65 to 511).
        method, quality: names, or entries of `invert.choices`.
        patch: patch size in pixels; None derives it from the lag pitch; "fit" also takes the width of the object into account.
        lags: largest lag on either side of zero, 32 to 255; the albedo has lags + 1 pixels along each axis.
        pitch_m: lag pitch. Without patch, lags and pitch, both are adapted to the object; see `invert.measure.lag_choice`.
        camera: metadata for frames that carry none.
        corrections: dark frame, flat-field frame and mask.
        blur_pixels: standard deviation of a known Gaussian blur; "auto" estimates it with the network. None also estimates
            it for `unet` and assumes no blur for the classical methods, which then run no network.
        mean_model: background model: auto, pooled, fixed or published; see `radiometry.estimation.autocorrelation_estimator`.
        weights: network weights for `unet` instead of those that ship.
        autocorrelation: whether files hold autocorrelations; None decides by their shape.
        sums_file: file (.npz) that keeps the sums over the frames of a capture above 1 GB, so that a later call continues from it.
        scheduler: address of a running Dask scheduler, whose workers add the frames of a capture above 1 GB. They need the same file names.
        progress: called with the number of steps done since the last call.

    Returns:
        the result, with its estimate, measurement and warnings.

    Raises InputError for input that cannot be inverted.
    """
    method, quality, mean_model = method_named(method), quality_named(quality), check_mean_model(mean_model)
    check_device(device)
    _check_types(source, camera, corrections, progress)
    _check_numbers(patch, blur_pixels)
    seed = SEED.check("seed", seed)
    if scheduler is not None:
        check_scheduler(scheduler)
    file = _check_weights(weights, method)
    begin = time.perf_counter()
    capture = read_source(source, camera or CameraMetadata(), autocorrelation)
    preparation: list[str] = []
    if isinstance(capture, Capture):
        capture, preparation = prepare(capture, corrections or Corrections())
    else:
        _refuse_without_frames(method)
        _refuse_frame_options(patch, lags, pitch_m, corrections, blur_pixels, mean_model)
    read_s = time.perf_counter() - begin
    known_blur = None if blur_pixels == "auto" else blur_pixels
    if isinstance(capture, Capture):
        kept = None if sums_file is None else path_of("sums_file", sums_file)
        estimate = estimate_from_frames(capture, patch, device, mean_model, known_blur, lags, pitch_m, kept, scheduler)
        if mean_model == "auto" and has_shifted(estimate.record) and (travel := find_travel(capture)):
            preparation.append(travel.describe())
            estimate = estimate_from_frames(capture, patch, device, "pooled", known_blur, lags, pitch_m, None, scheduler)
    else:
        estimate = capture

    begin = time.perf_counter()
    draft = None
    if method.is_network or blur_pixels == "auto":
        estimate, draft = estimate_blur(
            estimate, lambda seen, number: reconstruct_measurement(seen, UNET, FAST, seed + number, device, weights=file)
        )
    measurement = read_measurement(estimate.lags, estimate.quantisation, estimate.transfer)
    if draft is not None and (method, quality) == (UNET, FAST):
        reconstruction = draft
    else:
        reconstruction = reconstruct_measurement(measurement, method, quality, seed, device, progress, file)
    test = speckle_test(estimate, measurement, reconstruction.albedo) if reconstruction.object_found else None
    reconstruction, warnings = assess_reliability(
        reconstruction, test, measurement, partial(likelihood_before_division, estimate), estimate.record
    )
    if isinstance(capture, Capture) and _may_be_one_pattern(capture, estimate, reconstruction):
        single = reconstruct(
            mean_frame(capture),
            method=method,
            quality=quality,
            patch=patch,
            lags=lags,
            pitch_m=pitch_m,
            blur_pixels=blur_pixels,
            weights=weights,
            seed=seed,
            device=device,
            progress=progress,
        )
        if single.object_found and is_speckle(single.speckle_test):
            return replace(single, notes=(*preparation, ONE_PATTERN, *single.notes))
    seconds = {"read": read_s, "autocorrelation": estimate.seconds, "retrieval": time.perf_counter() - begin}
    fields, field_notes = None, []
    if isinstance(capture, Capture) and reconstruction.object_found and retrieves_fields(method, quality):
        begin = time.perf_counter()
        fields, field_notes = _retrieve_fields(capture, estimate, measurement, reconstruction, seed, device)
        seconds["fields"] = time.perf_counter() - begin
    settings = Settings(method.name, quality.name, seed)
    if isinstance(capture, Capture) and not retrieves_fields(method, quality):
        field_notes = _suggest_fields(estimate, measurement, reconstruction)
    notes = preparation + describe_limits(reconstruction, measurement) + field_notes
    if isinstance(capture, Capture):
        notes += describe_files(capture)
        warnings += stray_light_of(capture)
    return Result(estimate, measurement, reconstruction, settings, seconds, test, tuple(warnings), tuple(notes), fields)


ONE_PATTERN = (
    "the frames show one speckle pattern, as if the laser spot had not moved; their mean was reconstructed as one frame; "
    "move the spot between frames to gain from several"
)

MIN_PATTERN_LAGS = 0.9
"""Fraction of the lags at which frames share power, above which they may show one speckle pattern."""


def _may_be_one_pattern(capture: Capture, estimate: Estimate, found: Reconstruction) -> bool:
    """Return whether several frames share so much that nothing is left of the object."""
    background = None if estimate.record is None else estimate.record.background
    shared = (background and background.fixed_pattern_lags) or 0.0
    return not found.object_found and len(capture.frames) > 1 and shared > MIN_PATTERN_LAGS


def _retrieve_fields(
    capture: Capture, estimate: Estimate, measurement: Measurement, coarse: Reconstruction, seed: int, device: str
) -> tuple[FieldReconstruction | None, list[str]]:
    """Return the fields, or None with the reason why the coarse albedo stands."""
    try:
        found = retrieve_fields(capture, estimate, measurement, coarse, seed, device)
    except InputError as error:
        return None, [f"no fields were retrieved ({error}); the coarse albedo stands"]
    if found.certificate.is_accepted:
        used, given = found.frames, len(capture.frames)
        return found, [] if used == given else [f"fields were retrieved from {used} of {given} frames"]
    gain = f"{found.certificate.gain_nats_per_pixel:.2g} +- {found.certificate.gain_error:.1g} nats per pixel"
    return None, [f"the fields predict held-out pixels no better than a filter does (gain {gain}); the coarse albedo stands"]


def _suggest_fields(estimate: Estimate, measurement: Measurement, found: Reconstruction) -> list[str]:
    """Return a note if the light suffices for the fields."""
    record = estimate.record
    if record is None or not found.object_found:
        return []
    forecast = forecast_fields(
        found.albedo,
        measurement.floor_over_peak,
        record.frames,
        record.grid.frame_shape,
        record.grid.patch_shape,
        estimate.pitches_m,
    )
    if forecast is None or not forecast.suffices:
        return []
    return [f"--method field would show finer detail: {forecast.describe()}"]


def read_source(source: Source, camera: CameraMetadata, autocorrelation: bool | None = None) -> Capture | Estimate:
    """Read a source as a capture, or as an estimate if it is an autocorrelation. The arguments have the same meaning as in
    `reconstruct`.
    """
    if isinstance(source, Capture):
        in_memory = () if isinstance(source.frames, FileFrames) else source.frames
        for number, frame in enumerate(in_memory):
            check_frame(np.asarray(frame), Path(f"frame {number}"))
        return source
    if isinstance(source, Estimate):
        return source
    if isinstance(source, (str, Path)):
        source = [source]
    paths = [Path(item) for item in source if isinstance(item, (str, Path))] if isinstance(source, Sequence) else []
    if paths and len(paths) == len(source):
        if autocorrelation and len(paths) > 1:
            raise InputError("frames", "one file with --autocorrelation", f"{len(paths)} files", "give them one by one")
        if autocorrelation or (autocorrelation is None and len(paths) == 1 and _has_published_shape(paths[0])):
            return published_estimate(paths[0])
        return read_capture(paths, camera)
    return _read_array(source, camera, autocorrelation)


def _read_array(source: object, camera: CameraMetadata, autocorrelation: bool | None) -> Capture | Estimate:
    if isinstance(source, np.ma.MaskedArray) and np.ma.is_masked(source):
        raise InputError("frames", "arrays without a mask", "masked pixels", "provide the mask as corrections")
    try:
        array = np.asarray(source)
    except ValueError:
        raise InputError("frames", "frames of one size", "arrays of several shapes", "provide one array (n, H, W)") from None
    if (array.shape == (LAG_SIDE, LAG_SIDE) and autocorrelation is not False) or (autocorrelation and _is_of_lags(array)):
        if array.dtype.kind not in "uif":
            raise InputError("autocorrelation", "real numbers", f"{array.dtype}", "convert the array")
        check_power(array, "the array")
        check_symmetry(array, "the array")
        return Estimate("autocorrelation", np.array(array, np.float32))
    if autocorrelation:
        found = f"shape {array.shape}"
        expected = "an odd square array of 65 x 65 to 511 x 511 lags"
        raise InputError("autocorrelation", expected, found, "provide an estimate, or omit autocorrelation")
    if array.ndim == 2:
        array = array[None]
    if array.ndim != 3 or array.dtype.kind not in "uif" or len(array) == 0:
        found = f"{array.dtype} of shape {array.shape}"
        raise InputError("frames", "numbers of shape (frames, height, width)", found, "provide one channel of intensity")
    frames = [np.array(frame, np.float32) for frame in array]
    for number, frame in enumerate(frames):
        check_frame(frame, Path(f"frame {number}"))
    return Capture(frames, camera, tuple(f"frame {number}" for number in range(len(frames))))


def _is_of_lags(array: np.ndarray) -> bool:
    """Return whether an array has the shape of an estimate."""
    side = array.shape[-1] if array.ndim == 2 else 0
    return array.shape == (side, side) and side % 2 == 1 and LAG_COUNT.holds(side // 2)


def _has_published_shape(path: Path) -> bool:
    if not path.is_file():
        return False
    stack = open_stack(path)
    return stack.count == 1 and stack.read(0)[0].shape in ((LAG_SIDE, LAG_SIDE), (LAG_SIDE, 2 * LAG_SIDE))


def _check_types(source: object, camera: object, corrections: object, progress: object) -> None:
    if not callable(progress):
        raise InputError("progress", "a function of a number of steps", f"{progress!r:.60}", "provide a function or omit it")
    if isinstance(source, Capture) and camera is not None:
        raise InputError("camera", "no camera together with a capture, which has its own", "both", "create another Capture")
    for name, value, kind in (("camera", camera, CameraMetadata), ("corrections", corrections, Corrections)):
        if value is not None and not isinstance(value, kind):
            raise InputError(name, f"a {kind.__name__}", f"{value!r:.60}", f"create one with correlograph.{kind.__name__}")


def _check_numbers(patch: object, blur_pixels: object) -> None:
    if not (patch is None or isinstance(patch, Integral) or (isinstance(patch, str) and patch == "fit")):
        raise InputError("patch", 'a number of pixels, None or "fit"', f"{patch!r:.60}", "correct it")
    if not (blur_pixels is None or isinstance(blur_pixels, Real) or (isinstance(blur_pixels, str) and blur_pixels == "auto")):
        raise InputError("blur_pixels", 'a number of pixels, None or "auto"', f"{blur_pixels!r:.60}", "correct it")


def _check_weights(weights: str | Path | None, method: Method) -> Path | None:
    if weights is not None and not method.is_network:
        raise InputError("weights", f"method {UNET} or {FIELD}", f"method {method}", f"select method {UNET} or remove weights")
    return None if weights is None else path_of("weights", weights)


def _refuse_without_frames(method: Method) -> None:
    if method == FIELD:
        found = "an autocorrelation, which holds no phase of a frame"
        raise InputError("method", "frames for method field", found, f"provide frames, or select method {UNET}")


def _refuse_frame_options(
    patch: Patch, lags: int | None, pitch_m: float | None, corrections: Corrections | None, blur_pixels: Blur, mean_model: str
) -> None:
    """Refuse options that change the estimate of frames, because an autocorrelation is already an estimate."""
    given = [
        name
        for name, value, default in (
            ("patch", patch, None),
            ("lags", lags, None),
            ("pitch_m", pitch_m, None),
            ("corrections", (corrections or Corrections()).is_empty, True),
            ("blur_pixels", blur_pixels, None),
            ("mean_model", mean_model, "auto"),
        )
        if value != default
    ]
    if given:
        raise InputError("autocorrelation", "no option that applies to frames", ", ".join(given), "remove these options")
