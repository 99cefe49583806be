"""Frames of a moving object -> film."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from tqdm import tqdm

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.captured_frames import describe_files
from invert.assess.doubts import Doubt
from invert.assess.motion_blur import doubt_motion
from invert.assess.reliability import confidence_limit
from invert.measure.estimate import Estimate
from invert.measure.preparation import find_empty
from invert.measure.spectrum import read_measurement
from invert.methods import empty_reconstruction
from invert.output.result import Result
from invert.pipeline import ONE_PATTERN, choose_object, estimate_following, fulfil, may_be_one_pattern, read_prepared
from invert.request import Request
from invert.sources import Source, read_source
from invert.tracking.numbers import doubts_of_order, frame_numbers, missing_frames
from invert.tracking.rotation import rotation_of, signal_of
from invert.tracking.tables import check_frames
from invert.tracking.track import Track
from invert.video.film import Film
from invert.video.fine import of_one_size, retrieve_fields
from invert.video.looks import Looks
from invert.video.pooling import Pooling, pool, spread
from invert.video.sequence import register_sequence
from invert.video.turning import turn
from invert.video.windows import choose_window

MIN_FRAMES = 8
"""Minimum number of frames of a film."""

MAX_IMAGES = 48
"""Maximum number of images of a film without fields."""


def film(source: Source, *, interval_s: float | None = None, **options: Any) -> Film:
    """Reconstruct what an object looks like at each time.

    Frames are added along the path of the speckle, if the laser is at rest; turned back, if the object rotates about the line of sight; and
    pooled by as many patterns as the change of the object shows. If several objects move, the film shows one, which changes its place only.

    Args:
        source: a capture; frame files in order, or a folder of them; or frames (n, H, W).
        interval_s: time between the starts of two frames.
        options: attributes of `invert.request.Request`, such as quality, method and seed.

    Raises InputError for fewer than eight frames, and for frames that cannot be inverted.
    """
    return film_of(Request(**options), source, interval_s)


def film_of(request: Request, source: Source, interval_s: float | None = None) -> Film:
    """Reconstruct a film with the options of a request; see `film`."""
    capture, notes = _read(request, source)
    check_frames(capture, interval_s, MIN_FRAMES, "film")
    counted = frame_numbers(capture)
    notes += [*missing_frames(counted), *doubts_of_order(capture.names)]
    whole, followed = estimate_following(request, capture, MIN_FRAMES)
    chosen, _, of_objects = choose_object(request, whole, followed)
    path = followed.path_of(request.object_number)
    path = path and replace(path, interval_s=interval_s)
    if path is not None and len(followed.objects) > 1:
        alone = fulfil(request.for_estimate(), chosen)
        return _film_of_one(alone, path, counted, interval_s, [*notes, *followed.notes, *of_objects, *path.warnings])
    if may_be_one_pattern(capture, whole) and ONE_PATTERN in (single := fulfil(request.for_capture(), capture)).notes:
        return _film_of_one(single, None, counted, interval_s, notes)
    looks = Looks.of(followed.capture, whole, request)
    looks, pooling, of_turn = _turn_back(looks)
    numbers, of_fields = pooling.times(MAX_IMAGES), []
    found, frames = _reconstruct(request, looks, pooling.weights, numbers), pooling.frames
    if request.retrieves_fields:
        still = choose_window(looks.with_angles(np.zeros(len(looks.values))))
        found, of_fields = retrieve_fields(request, followed.capture, looks, still, found, numbers)
        images, numbers = of_one_size([one.albedo for one in found]), np.array(still.middles())
        frames = min(2 * still.half_width + 1, still.frames)
    else:
        images, numbers = _at_their_angles(found, looks, numbers, moves=path is not None)
    side, doubts = len(images[0]), pooling.doubts + (() if path is None else _doubt(path, whole))
    pooled = frames * len(capture.frames) / len(looks.values)
    warnings = [one.advice for one in doubts if one.is_raised] + [warning for one in found for warning in one.warnings]
    return Film(
        albedos=np.stack(images),
        middle_frame=np.interp(followed.middle_frame[numbers], np.arange(len(counted)), counted),
        confidence=np.resize([min(_confidence(one), confidence_limit(doubts)) for one in found], len(images)),
        frames_per_image=round(pooled),
        angle_deg=looks.turns[numbers] if looks.turns.any() else None,
        path=path,
        pitches_m=_pitches_m(looks, side),
        interval_s=interval_s,
        notes=tuple(dict.fromkeys([*notes, *followed.notes, *of_turn, *of_fields, *warnings])),
    )


def _doubt(path: Track, whole: Estimate) -> tuple[Doubt, ...]:
    """Return the doubt that motion blurs the speckle."""
    return doubt_motion(path.path_pixels, whole.record, read_measurement(whole.values, whole.quantisation, whole.transfer))


def _film_of_one(alone: Result, path: Track | None, counted: np.ndarray, interval_s: float | None, notes: list[str]) -> Film:
    """Return the film of an object that changes its place only: its image, to which all frames contribute, along its path if it has one.

    Args:
        counted: number of each frame.
    """
    if not alone.object_found:
        raise InputError(
            "frames", "light of a hidden object", "none at any time", "add light or frames, or move the laser between frames"
        )
    numbers = counted[spread(len(counted), MAX_IMAGES)] if path else counted[[len(counted) // 2]]
    return Film(
        albedos=np.repeat(alone.albedo[None], len(numbers), 0),
        middle_frame=numbers.astype(float),
        confidence=np.full(len(numbers), alone.confidence),
        frames_per_image=len(counted),
        path=path,
        pitches_m=alone.pitches_m,
        interval_s=interval_s,
        notes=tuple(dict.fromkeys([*notes, *alone.notes, *alone.warnings])),
    )


def _read(request: Request, source: Source) -> tuple[Capture, list[str]]:
    """Return prepared frames, and notes. Raises InputError unless the source is a sequence of frames."""
    request.check_source(source)
    shown = read_source(source, request.camera or CameraMetadata(), request.autocorrelation)
    if not isinstance(shown, Capture):
        raise InputError("source", "frames", "an autocorrelation", "provide frames in order")
    if request.mean_model == "published":
        raise InputError("mean_model", "auto, pooled or fixed for a film", request.mean_model, "select another")
    if request.blur_pixels == "auto" and request.method.weights is None:
        raise InputError("blur_pixels", "a number for a film by this method", "auto", "give it, or select method unet")
    if empty := find_empty(shown):
        found = f"none in {', '.join(empty.values())}"
        raise InputError("frames", "light in each frame of a film", found, "cut the film at the dark frames")
    prepared, notes = read_prepared(replace(request, camera=None, autocorrelation=None), shown)
    assert isinstance(prepared, Capture)
    if not any(np.any(frame) for frame in prepared.frames):
        raise InputError("frames", "light in each frame of a film", "zeros", "use frames with light")
    return prepared, notes + describe_files(shown)


def _pitches_m(looks: Looks, side: int) -> tuple[float, float] | None:
    """Return the pitches of images of a number of pixels, along rows and columns."""
    pitches, cells = looks.whole.pitches_m, side / looks.whole.lag_grid.object_side
    return None if pitches is None else (pitches[0] / cells, pitches[1] / cells)


def _confidence(result: Result) -> float:
    """Return the confidence of the image that is shown."""
    of_fields = None if result.fields is None else result.fields.confidence
    return result.confidence if of_fields is None else of_fields


def _turn_back(looks: Looks) -> tuple[Looks, Pooling, list[str]]:
    """Return the looks with angles, how they are pooled, and a note, if it changes by fewer patterns then, or no longer by more than its
    noise; otherwise what was given."""
    unturned = pool(looks)
    if _rank(unturned) == (0, False):
        return looks, unturned, []
    try:
        rotation = rotation_of([signal_of(one, looks.whole.transfer) for one in looks.values], looks.aspect, looks.noise**-2.0)
    except InputError:
        return looks, unturned, []
    turned = looks.with_angles(rotation.angle_at(np.arange(len(looks.values))))
    pooling = pool(turned)
    if _rank(pooling) >= _rank(unturned):
        return looks, unturned, []
    return turned, pooling, [f"the object turns by {turned.turns[-1]:.0f} degrees; frames were turned back and pooled"]


def _rank(pooling: Pooling) -> tuple[int, bool]:
    """Return the number of patterns of change, and whether a change without patterns is suspected: less is better."""
    return pooling.patterns, any(one.is_raised for one in pooling.doubts)


def _reconstruct(request: Request, looks: Looks, weights: np.ndarray, numbers: np.ndarray) -> list[Result]:
    """Return the results at the times of frames of some numbers, from sums of all frames with weights (frames, frames), at the angle of the
    first frame. Raises InputError if none shows an object."""
    options = request.for_estimate()
    # What stays the same has equal weights at all times, but for rounding.
    _, first, which = np.unique(weights[numbers].round(9), axis=0, return_index=True, return_inverse=True)
    images = tqdm(weights[numbers[first]], desc="images", unit="image", disable=None, leave=False)
    each = [fulfil(options, looks.combine(looks.upright, chosen)) for chosen in images]
    found = [each[number] for number in which.ravel()]
    for number in np.flatnonzero(looks.are_dark[numbers]):  # a weighted sum of others
        nothing = empty_reconstruction(len(found[number].coarse_albedo))
        found[number] = replace(found[number], reconstruction=nothing, warnings=())
    shown = [number for number, one in enumerate(found) if one.object_found]
    if not shown:
        raise InputError(
            "frames", "light of a hidden object", "none at any time", "add light or frames, or move the laser between frames"
        )
    for number, albedo in zip(shown, register_sequence(np.stack([found[one].coarse_albedo for one in shown])), strict=True):
        found[number] = replace(found[number], reconstruction=replace(found[number].reconstruction, albedo=albedo))
    return found


def _at_their_angles(
    found: list[Result], looks: Looks, numbers: np.ndarray, *, moves: bool
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the images of a film at the angles of the object, and the number of the look of each.

    An object of which nothing but angle and place change has one result; it is shown at many times.
    """
    shown, count = [one.albedo for one in found], len(looks.values)
    if len(found) == 1 and (moves or looks.turns.any()):
        numbers = spread(count, MAX_IMAGES)
        shown = shown * len(numbers)
    return [turn(one, angle, looks.aspect).clip(0.0) for one, angle in zip(shown, looks.turns[numbers], strict=True)], numbers
