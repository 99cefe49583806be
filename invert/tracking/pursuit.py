"""Objects of a capture: those found by frames far apart first, then, in what their light leaves, those found by frames closer together.

Frames further apart tell objects of little different speed from one another, as long as the speckle of both stays the same.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations

import numpy as np

from correlograph.errors import InputError
from invert.tracking.band import MAX_LIKENESS, MAX_LIKENESS_LEFT, Band
from invert.tracking.breaks import follow_over_jumps, mend
from invert.tracking.follow import follow
from invert.tracking.separation import subtract_light
from invert.tracking.shifts import weight_of
from invert.tracking.start import Start, are_apart, distances, find_brightest, paths_at, share_along, way_apart

MAX_LAG, MAX_LAG_SHARE = 32, 0.6
"""Largest distance of the frames by which several objects are told apart, in frames and over their number. Halves of it follow."""

MIN_SHARE = 0.1
"""Least share of the power of the speckle that consecutive frames of a single object have in common; static light has less, where the laser
moves."""

FRAMES_FOR_NUMBER = 64
"""Number of frames, in the middle of the capture, that decide whether there are several objects."""

BLOCKS = (8, 2)
"""Numbers of blocks of frames that are tried for further objects: many follow a curved path, few see less light."""

MIN_PERSISTENCE = 0.2
"""Least share of an object in frames at another distance over that at the distance by which it was found."""

BETTER = 1.1
"""Factor by which one object must explain more than the first of several to be the only one."""

LITTLE = 0.5
"""The same where there is only one other."""

MIN_RELATIVE_SHARE = 0.15
"""Least share of an object over that of the brightest. Maxima beside those of the brightest have a fifth of its height, of which the
subtraction of its light leaves a half."""

ALONE_SHARE = 1.0 / (1.0 + MIN_RELATIVE_SHARE)
"""Share of the speckle along one path that leaves too little for another object."""

FADING_SIGMA, MAX_WAY_SHARE = 3.0, 0.2
"""Standard errors by which speckle along a path fades before it is said to, and share of a side by which it moves meanwhile at most."""


def find_objects(spectra: np.ndarray, band: Band) -> list[Start]:
    """Return the objects of a capture, the brightest first.

    A single object is followed by consecutive frames.

    Args:
        spectra: (frames, R, C).

    Raises InputError if the whole capture shows no common motion.
    """
    alone = mend(spectra, band, find_brightest(spectra, band))
    middle = max(0, len(spectra) - FRAMES_FOR_NUMBER) // 2
    some = np.s_[middle : middle + FRAMES_FOR_NUMBER]
    lags = _lags_for_others(alone.path[some], spectra[some], band)
    several = _drop_interference(_pursue(spectra[some], band, lags))
    if len(several) == 1 and _explains_alone(alone.path[some], several[0], spectra[some], band):
        several = []
    if several and len(spectra) > FRAMES_FOR_NUMBER:
        several = _drop_interference(_pursue(spectra, band, lags))
    is_one = _persists(alone, spectra, band)
    if several and not (is_one and _explains(alone, several, spectra, band)):
        return sorted(several, key=lambda one: -one.share)
    if not is_one:
        expected, remedy = "speckle that moves as a whole", "keep the laser and the camera at rest"
        raise InputError("frames", expected, "displacements that do not continue from frame to frame", remedy)
    if alone.share < MIN_SHARE:
        expected, remedy = "speckle that moves as a whole", "keep the laser at rest, and shorten the interval"
        raise InputError("frames", expected, f"{100.0 * alone.share:.2g} % of its power in common", remedy)
    return [alone]


def _lags_for_others(path: np.ndarray, spectra: np.ndarray, band: Band) -> list[int]:
    """Return the distances of frames by which further objects could be found: those larger than one at which a single object leaves too
    little of the power for another."""
    lags = [_largest_lag(len(spectra))]
    while lags[-1] > 3:
        lags.append(lags[-1] // 2)
    lags = [one for one in lags if one > 1]
    for index, lag in enumerate(lags):
        if share_along(spectra, band, path, lag) > ALONE_SHARE:
            return lags[:index]
    return lags


def _largest_lag(frames: int) -> int:
    return min(MAX_LAG, int(MAX_LAG_SHARE * frames))


def fading_along(spectra: np.ndarray, band: Band, path: np.ndarray) -> tuple[int, float] | None:
    """Return a distance of frames and the part of what consecutive ones share along the path (frames, 2) of a single object that frames so
    far apart still share; None if it leaves no room for another object."""
    weight = weight_of(band, 0.0)
    # The overlap of windows far apart is known less well.
    steps = np.abs(path[-1] - path[0]) / (len(path) - 1) / np.array(band.shape)
    lag = min(_largest_lag(len(spectra)), int(MAX_WAY_SHARE / max(steps.max(), 1e-9)))
    if lag < 2:
        return None
    near, far = (share_along(spectra, band, path, one) for one in (1, lag))
    noise = weight.deviation / (weight.full * (len(spectra) - lag) ** 0.5)
    error = np.hypot(noise, near / band.cells**0.5)  # of bright speckle, each cell is seen once
    return (lag, max(far, 0.0) / near) if near > 0.0 and far + FADING_SIGMA * error < ALONE_SHARE * near else None


def _explains(alone: Start, several: list[Start], spectra: np.ndarray, band: Band) -> bool:
    """Return whether an object that was found and followed by consecutive frames explains the capture, by what it has in common at the lag
    of the first of others.

    Of one other object, it must have at least `LITTLE`, or else its path is that of the interference of two. Of several, it must have
    more: speckle that changes quickly has several maxima at large lags, none of which lies at its place. Or each of them lies at its place
    and has no more, because the path jumps; the place of an interference lies near both objects, too, but has less.
    """
    try:
        path = follow_over_jumps(spectra, band, alone).path
    except InputError:  # nothing in common across a boundary, which several objects can show as well
        return len(several) == 1
    if len(several) == 1:
        return _explains_alone(path, several[0], spectra, band)
    exact = replace(several[0], path=follow(spectra, band, several[0]).path)  # as that of the single one; or drawn to others

    def is_at_its_place(one: Start) -> bool:
        return not are_apart(path, one.path, one.lag, band) and _has_as_much(path, one, 1.0 / BETTER, spectra, band)

    is_better = all(_has_as_much(path, one, BETTER, spectra, band) for one in (several[0], exact))
    return is_better or all(map(is_at_its_place, several))


def _has_as_much(path: np.ndarray, other: Start, factor: float, spectra: np.ndarray, band: Band) -> bool:
    """Return whether frames at the lag of another object have more in common along a path (frames, 2) than a factor times what they have
    along that of the other."""
    return share_along(spectra, band, path, other.lag) > factor * share_along(spectra, band, other.path, other.lag)


def _explains_alone(path: np.ndarray, other: Start, spectra: np.ndarray, band: Band) -> bool:
    """Return whether a path (frames, 2) explains the only other object: at its lag, or at all distances together by which it was found.
    Where nothing is left in common at the largest, noise decides there."""
    if _has_as_much(path, other, LITTLE, spectra, band):
        return True
    own, others = (sum(share_along(spectra, band, one, lag) for lag in distances(other.lag)) for one in (path, other.path))
    return own > others


def _drop_interference(found: list[Start]) -> list[Start]:
    """Return objects without those that move at the mean of two others, as their interference does: closer to it than to either."""

    def is_between(one: Start) -> bool:
        pairs = combinations((other.path for other in found if other is not one), 2)
        return any(way_apart(one.path, 0.5 * (a + b), one.lag) < 0.25 * way_apart(a, b, one.lag) for a, b in pairs)

    return [one for one in found if not is_between(one)]


def _pursue(spectra: np.ndarray, band: Band, lags: Iterable[int]) -> list[Start]:
    """Return all objects that frames at some distances, the largest first, show.

    Beside objects that are known, interference displaces the maxima of others, which are therefore sought without the light of these.
    Where this finds no second one, whole frames may: what is subtracted contains some of its light.
    """
    found: list[Start] = []
    for lag in lags:
        while best := _in_what_is_left(spectra, band, lag, found) or (len(found) < 2 and _most(spectra, band, lag, found)):
            found += best
    return found


def _in_what_is_left(spectra: np.ndarray, band: Band, lag: int, known: list[Start]) -> list[Start]:
    """Return the new objects at a distance of frames without the light of those that are known; none before one is."""
    return _most(subtract_light(spectra, band, known, lag), band, lag, known, MAX_LIKENESS_LEFT) if known else []


def _most(spectra: np.ndarray, band: Band, lag: int, known: list[Start], likeness: float = MAX_LIKENESS) -> list[Start]:
    """Return the new objects at a distance of frames, from blocks of the length that shows most; `likeness` is the largest halfway to known
    ones."""
    lengths = dict.fromkeys(max(1, (len(spectra) - lag) // blocks) for blocks in BLOCKS)
    tried = [_new(paths_at(spectra, band, lag, length)[0], known, spectra, band, likeness) for length in lengths]
    return max(tried, key=lambda some: (len(some), sum(one.significance for one in some)))


def _new(candidates: Iterable[Start], known: list[Start], spectra: np.ndarray, band: Band, likeness: float) -> list[Start]:
    """Return the candidates that persist, are bright enough, and are apart from known objects and from one another."""
    found: list[Start] = []
    for one in candidates:
        others = [*known, *found]
        is_bright = one.share > MIN_RELATIVE_SHARE * max((other.share for other in others), default=0.0)
        is_apart = all(are_apart(one.path, other.path, one.lag, band, likeness) for other in others)
        if is_bright and is_apart and _persists(one, spectra, band):
            found.append(one)
    return found


def _persists(one: Start, spectra: np.ndarray, band: Band) -> bool:
    """Return whether frames at another distance show an object at its path, too: one of several shorter distances, as interference may
    hide it at some. A camera that shakes back and forth looks like two objects that move in opposite directions, until then, and frames
    before and after a jump look like an object that moves faster."""
    if len(spectra) < 4:
        return True
    others = {1, one.lag // 4, one.lag // 2} - {0} if one.lag > 1 else {2}
    shares = [share_along(spectra, band, one.path, other) for other in others]
    return max(shares) > MIN_PERSISTENCE * share_along(spectra, band, one.path, one.lag)
