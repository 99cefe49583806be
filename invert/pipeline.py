"""The one path from a source to a result: read, estimate, find an unknown blur, reconstruct, assess, retrieve fields."""

from __future__ import annotations

import inspect
import time
from dataclasses import fields, replace
from functools import partial
from typing import Any

from tqdm import tqdm

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.captured_frames import describe_files, stray_light_of
from correlograph.files.corrections import Corrections
from correlograph.workers import check_scheduler
from invert.assess.frame_remarks import describe_frames
from invert.assess.hypotheses import MIN_SHARED_LAGS, blurred_share, object_probability, weigh_hypotheses
from invert.assess.motion_blur import doubt_motion
from invert.assess.reliability import (
    beside_other,
    describe_limits,
    find_doubts,
    is_speckle,
    lower_confidence,
)
from invert.assess.speckle_test import speckle_test
from invert.blur_fit import MAX_RECONSTRUCTIONS, BlurSearch, likelihood_before_division, search_blur
from invert.choices import FAST, UNET
from invert.field.reconstruction import FieldReconstruction
from invert.field.retrieval import retrieve_fields
from invert.measure.estimate import Estimate, estimate_from_frames, per_measured_pixel
from invert.measure.preparation import prepare
from invert.measure.spectrum import Measurement, read_measurement
from invert.methods import Reconstruction, reconstructor
from invert.network.checkpoints import load_network, untrained_parts
from invert.output.outcome import MethodSettings
from invert.output.result import Result
from invert.request import Request
from invert.sources import Source, read_source
from invert.tracking.alone import estimate_alone
from invert.tracking.stabilise import MIN_GROUPS, Stabilised, estimate_along, follow_travel, mean_pattern
from radiometry.field_forecast import forecast_fields

MAX_SHARED_CONFIDENCE = 0.7
"""Confidence of frames that share most of their light up to which their sum is tried as well. What is left of one pattern has 0.5; a
texture that shakes leaves the object 0.86 or more."""

ONE_PATTERN = (
    "the frames show one speckle pattern, as if the laser spot had not moved; their sum was reconstructed as one frame; "
    "move the spot between frames to gain from several"
)

NO_FIELDS = "no fields were retrieved, because each frame shows all objects"

MAX_LEFT = 0.5
"""Maximum weight of the coarse albedo in that of the fields: beyond it, the counts of the frames have added less than half."""


def reconstruct(source: Source, **options: Any) -> Result:
    """Reconstruct the albedo of the hidden object.

    Args:
        source: a capture; a frame file, several, or a folder of them; frames (n, H, W) or (H, W); an estimate; or a published
            autocorrelation, as a file or an array of 127 x 127 lags (an array may have 65 to 511).
        options: attributes of `invert.request.Request`, such as method, quality, camera and seed.

    Returns:
        the result, with its estimate, measurement and warnings.

    Raises InputError for input that cannot be inverted.
    """
    unknown = options.keys() - {one.name for one in fields(Request)}
    if unknown:
        camera = {one.name for one in fields(CameraMetadata)}
        hint = "; give lengths in camera=CameraMetadata(...)" if unknown & camera else ""
        raise TypeError(f"reconstruct() has no option {', '.join(sorted(unknown))}{hint}")
    return fulfil(Request(**options), source)


reconstruct.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
    [
        inspect.Parameter("source", inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation="Source"),
        *(one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in inspect.signature(Request).parameters.values()),
    ],
    return_annotation="Result",
)


def fulfil(request: Request, source: Source) -> Result:
    """Reconstruct a source with the options of a request; see `reconstruct`."""
    begin = time.perf_counter()
    shown, notes = read_prepared(request, source)
    seconds = {"read": time.perf_counter() - begin}
    if isinstance(shown, Estimate):
        capture, estimate, path, may_shake = None, shown, None, False
    else:
        estimate, followed = estimate_following(request, shown)
        estimate, capture, of_objects = choose_object(request, estimate, followed)
        if capture is shown and shown.measured is not None:  # frames that were moved back have no common mask
            estimate = per_measured_pixel(estimate, shown.measured)
        path, may_shake = followed.path_of(request.object_number), followed.may_shake
        notes += followed.notes + of_objects + describe_files(shown)
    seconds["autocorrelation"] = estimate.seconds

    begin = time.perf_counter()
    search, measurement, found = _retrieve(request, estimate)
    estimate = search.estimate
    test = speckle_test(estimate, measurement, found.albedo) if found.object_found else None
    likelihood = partial(likelihood_before_division, estimate)
    doubts = find_doubts(found, test, likelihood, estimate.record)
    if path is not None and found.object_found:
        doubts += doubt_motion(path.path_pixels, estimate.record, measurement)
    motion = None if path is None else path.significance
    hypotheses = weigh_hypotheses(measurement, estimate.record, test, motion, may_shake=may_shake)
    blurred = blurred_share(hypotheses)
    found = beside_other(found, search.other, blurred if estimate.blur_pixels is None else 1.0 - blurred)
    found = lower_confidence(found, doubts, object_probability(hypotheses))
    warnings = [one.advice for one in doubts if one.is_raised] + describe_frames(estimate.record, measurement)
    if path is not None and estimate.record is not None and estimate.record.object_number is not None:
        warnings += path.warnings
    if capture is not None and found.confidence <= MAX_SHARED_CONFIDENCE and may_be_one_pattern(capture, estimate):
        single = _of_one_pattern(request, capture)
        if single is not None and single.confidence > found.confidence:
            return replace(single, notes=(*notes, ONE_PATTERN, *single.notes))
    notes += describe_limits(found, measurement, estimate, hypotheses)
    seconds["retrieval"] = time.perf_counter() - begin

    settings = MethodSettings(request.method.name, request.quality.name, request.seed)
    result = Result(estimate, measurement, found, settings, seconds, test, doubts, hypotheses, track=path)
    if isinstance(shown, Capture):
        warnings += stray_light_of(shown)
    if capture is not None:
        result, more = add_fields(request, capture, result)
        notes += more
    if request.weights is not None and (missing := untrained_parts(load_network(request.weights, request.device)[1])):
        warnings.append(
            f"{request.weights.name} holds parts that were not trained ({', '.join(missing)}); train them or use the shipped weights"
        )
    return replace(result, warnings=tuple(warnings), notes=tuple(notes))


def read_prepared(request: Request, source: Source) -> tuple[Capture | Estimate, list[str]]:
    """Return a source as an estimate, or as a capture of prepared frames with notes on what was done to them."""
    request.check_source(source)
    if request.scheduler is not None:
        check_scheduler(request.scheduler)
    shown = read_source(source, request.camera or CameraMetadata(), request.autocorrelation)
    if isinstance(shown, Capture):
        return prepare(shown, request.corrections or Corrections())
    request.check_estimate()
    return shown, []


def estimate_following(request: Request, capture: Capture, groups: int = MIN_GROUPS) -> tuple[Estimate, Stabilised]:
    """Estimate r*r from frames, and return those that it is from.

    Frames of one speckle that travels are pooled, and follow it if it is that of one object.

    Args:
        groups: minimum number of groups of frames.
    """
    estimate = estimate_from_frames(capture, request)
    if request.mean_model != "auto":
        return estimate, Stabilised.at_rest(capture)
    followed = follow_travel(capture, estimate.filtered_frames, groups)
    if followed.travel is not None:
        along = replace(request, mean_model="pooled", sums_file=None, object_number=1)
        pooled = estimate_along(followed.capture, along, followed.blur_pixels)
        estimate = replace(pooled, name=estimate.name)
    return estimate, followed


def choose_object(request: Request, estimate: Estimate, followed: Stabilised) -> tuple[Estimate, Capture | None, list[str]]:
    """Return the estimate of the object that was asked for, the frames that show it alone, or None, and a note, if several objects move.

    Raises InputError if there is no such object.
    """
    objects, number = followed.objects, request.object_number
    if number > max(len(objects), 1):
        found = f"{number}, of {len(objects)} moving objects" if objects else f"{number}, where no object was found to move"
        raise InputError("object_number (--object)", f"1 to {max(len(objects), 1)}", found, "select another, or omit it")
    if len(objects) < 2:
        return estimate, followed.capture, []
    alone = estimate_alone(followed.capture, objects, number - 1, request, estimate)
    note = f"{len(objects)} objects move; this is number {number} alone; --object (object_number=) selects another"
    return alone, None, [note, NO_FIELDS] if request.retrieves_fields else [note]


def _retrieve(request: Request, estimate: Estimate) -> tuple[BlurSearch, Measurement, Reconstruction]:
    """Find an unknown blur and reconstruct."""
    search = _search_blur(request, estimate) if request.finds_blur else BlurSearch(estimate)
    estimate = search.estimate
    measurement = read_measurement(estimate.values, estimate.quantisation, estimate.transfer)
    if search.draft is not None and (request.method, request.quality) == (UNET, FAST):
        return search, measurement, search.draft
    chosen = reconstructor(request.method, request.quality, request.device, request.weights)
    return search, measurement, chosen.run(measurement, request.seed, request.progress)


def _search_blur(request: Request, estimate: Estimate) -> BlurSearch:
    """Search for a blur with reconstructions of quality `fast`."""
    network = reconstructor(UNET, FAST, request.device, request.weights)
    with tqdm(total=MAX_RECONSTRUCTIONS, desc="blur", unit="reconstruction", disable=None, leave=False, delay=1.0) as bar:

        def draft(measurement: Measurement, number: int) -> Reconstruction:
            found = network.run(measurement, request.seed + number)
            bar.update()
            request.progress(0)  # whoever waits may end the work here
            return found

        return search_blur(estimate, draft)


def _of_one_pattern(request: Request, capture: Capture) -> Result | None:
    """Return the result from the sum of all frames as one; None if it shows no object by speckle."""
    try:
        single = fulfil(request.for_capture(), mean_pattern(capture))
    except InputError:  # such as a patch that was chosen for larger frames
        return None
    return single if single.object_found and is_speckle(single.speckle_test) else None


def may_be_one_pattern(capture: Capture, estimate: Estimate) -> bool:
    """Return whether several frames share so much that nothing may be left of the object."""
    background = None if estimate.record is None else estimate.record.background
    shared = (background and background.fixed_pattern_lags) or 0.0
    return len(capture.frames) > 1 and shared > MIN_SHARED_LAGS


def add_fields(request: Request, capture: Capture, result: Result) -> tuple[Result, list[str]]:
    """Return the result with the field of each frame, or, if they were not asked for, a note where the light suffices for them."""
    if not request.retrieves_fields:
        return result, _suggest_fields(result)
    if not result.object_found:
        return result, []
    begin = time.perf_counter()
    found, notes = _retrieve_fields(request, capture, result)
    seconds = result.seconds | {"fields": time.perf_counter() - begin}
    return replace(result, fields=found, seconds=seconds), notes


def _retrieve_fields(request: Request, capture: Capture, result: Result) -> tuple[FieldReconstruction | None, list[str]]:
    """Return the fields, or None with the reason why the coarse albedo stands."""
    try:
        found = retrieve_fields(capture, result.estimate, result.reconstruction, request.seed, request.device, request.quality)
    except InputError as error:
        return None, [f"no fields were retrieved ({error}); the coarse albedo stands"]
    if not found.certificate.is_accepted:
        gain = f"{found.certificate.gain_nats_per_pixel:.2g} +- {found.certificate.gain_error:.1g} nats per pixel"
        return None, [
            f"the fields predict held-out pixels no better than a filter does (gain {gain}); the coarse albedo stands"
        ]
    if found.coarse_weight > MAX_LEFT:
        left = f"up to {100.0 * found.coarse_weight:.0f} % of the coarse albedo"
        return None, [f"the fields add too little: {left} is left in their albedo; the coarse albedo stands"]
    used, given = found.frames, len(capture.frames)
    return found, [] if used == given else [f"fields were retrieved from {used} of {given} frames"]


def _suggest_fields(result: Result) -> list[str]:
    """Return a note if the light suffices for the fields."""
    record = result.estimate.record
    if record is None or not result.object_found:
        return []
    floor_over_peak, pitches_m = result.measurement.floor_over_peak, result.estimate.pitches_m
    grid = record.grid
    forecast = forecast_fields(
        result.coarse_albedo, floor_over_peak, record.frames, grid.frame_shape, grid.patch_shape, pitches_m
    )
    if forecast is None or not forecast.suffices:
        return []
    return [f"--method field would show finer detail: {forecast.describe()}"]
