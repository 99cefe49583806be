"""Frames of a moving object -> film."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from tqdm import tqdm

from correlograph.errors import InputError
from correlograph.files.capture import Capture
from invert.albedo.metrics import aligned_pearson
from invert.measure.estimate import estimate_from_frames
from invert.output.result import Result
from invert.pipeline import fulfil, read_prepared
from invert.request import Request
from invert.sources import Source
from invert.tracking.rotation import rotation_of, signal_of
from invert.tracking.stabilise import follow_travel
from invert.tracking.tables import check_frames
from invert.tracking.track import Track
from invert.video.film import Film
from invert.video.looks import Looks
from invert.video.turning import turn
from invert.video.windows import Window, choose_window

MIN_FRAMES = 8
"""Minimum number of frames of a film."""

TURNED_IMAGES = 48
"""Number of images of an object that only turns."""


def film(source: Source, *, interval_s: float | None = None, **options: Any) -> Film:
    """Reconstruct what an object looks like at each time.

    Frames are pooled for as long as the object stays the same: along the path of its speckle, if the laser is at rest; turned back, if the
    object rotates about the line of sight; and over the longest window of time in which no change shows.

    Args:
        source: a capture; frame files in order, or a folder of them; or frames (n, H, W).
        interval_s: time between the starts of two frames.
        options: attributes of `invert.request.Request`, such as quality, method and seed.

    Raises InputError for fewer than eight frames, and for frames that cannot be inverted.
    """
    return film_of(Request(**options), source, interval_s)


def film_of(request: Request, source: Source, interval_s: float | None = None) -> Film:
    """Reconstruct a film with the options of a request; see `film`."""
    capture, notes = read_prepared(request, source)
    if not isinstance(capture, Capture):
        raise InputError("source", "frames", "an autocorrelation", "provide frames in order")
    check_frames(capture, interval_s, MIN_FRAMES, "film")
    looks, times, path, of_path = _follow(request, capture)
    looks, window, of_window = _choose(looks)
    found = _reconstruct(request, looks, window)
    images, numbers = _images(found, looks, window)
    return Film(
        albedos=images,
        middle_frame=times[numbers],
        confidence=np.resize([one.confidence for one in found], len(images)),
        frames_per_image=round(len(capture.frames) / window.frames * min(2 * window.half_width + 1, window.frames)),
        angle_deg=looks.turns[numbers] if looks.turns.any() else None,
        path=path,
        pitches_m=found[0].pitches_m,
        interval_s=interval_s,
        notes=tuple(dict.fromkeys([*notes, *of_path, *of_window, *(warning for one in found for warning in one.warnings)])),
    )


def _follow(request: Request, capture: Capture) -> tuple[Looks, np.ndarray, Track | None, list[str]]:
    """Return r*r of each frame that follows the object, the number of the frame in its middle, the path of the object, and notes."""
    filtered = estimate_from_frames(capture, request).filtered_frames
    followed = follow_travel(capture, filtered, MIN_FRAMES) if request.mean_model == "auto" else None
    if followed is None:
        return Looks.of(capture, request), np.arange(float(len(capture.frames))), None, []
    looks = Looks.of(followed.capture, replace(request, mean_model="pooled"))
    return looks, followed.middle_frame, followed.track, followed.notes


def _choose(looks: Looks) -> tuple[Looks, Window, list[str]]:
    """Return the looks, with angles if the object then stays the same for longer; the window; and notes."""
    still = choose_window(looks)
    try:
        rotation = rotation_of([signal_of(one, looks.whole.transfer) for one in looks.values], looks.aspect)
    except InputError:
        return looks, still, []
    turned = looks.with_angles(rotation.angle_at(np.arange(len(looks.values))))
    turning = choose_window(turned)
    if turning.half_width <= still.half_width:
        return looks, still, []
    return turned, turning, [f"the object turns by {rotation.angle_deg[-1]:.0f} degrees; frames were turned back and pooled"]


def _reconstruct(request: Request, looks: Looks, window: Window) -> list[Result]:
    """Return the results of all windows, at the angle of the first frame. Raises InputError if no window shows an object."""
    upright, options = looks.turned_back(), request.for_estimate()
    middles = tqdm(window.middles(), desc="images", unit="image", disable=None, leave=False)
    found = [fulfil(options, looks.mean(upright, window.around(middle))) for middle in middles]
    if not any(one.object_found for one in found):
        raise InputError("frames", "light of a hidden object", "none at any time", "add light or frames")
    return found


def _images(found: list[Result], looks: Looks, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Return the images of a film at the angles of the object, (images, n, n), and the number of the look in the middle of each.

    An object of which nothing but the angle changes has one result; it is shown at many angles.
    """
    shown, numbers = _continued([one.albedo for one in found]), np.array(window.middles())
    if window.holds_all and looks.turns.any():
        numbers = np.unique(np.rint(np.linspace(0, window.frames - 1, min(TURNED_IMAGES, window.frames))).astype(int))
        shown = shown * len(numbers)
    turned = [turn(one, angle, looks.aspect).clip(0.0) for one, angle in zip(shown, looks.turns[numbers], strict=True)]
    return np.stack(turned), numbers


def _continued(albedos: list[np.ndarray]) -> list[np.ndarray]:
    """Return albedos, each registered to the one before; r*r leaves place and half turns open."""
    found = albedos[:1]
    for one in albedos[1:]:
        found.append(aligned_pearson(one, found[-1])[1] if one.any() and found[-1].any() else one)
    return found
