"""Objects of a capture: the paths that together make all frames most likely.

Candidates are the maxima of the cross-correlation of frames, and of what known objects leave of them, at several distances. Objects are
added one by one, each with the paths of all at the maximum of their likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from correlograph.errors import InputError
from invert.tracking.band import Band
from invert.tracking.breaks import follow_over_jumps, mend
from invert.tracking.central_lobe import central_lobe
from invert.tracking.joint import follow_several
from invert.tracking.light import light_of_frames
from invert.tracking.likely_path import refine_dim_path
from invert.tracking.several import MIN_RELATIVE_POWER, Several
from invert.tracking.shares import Shares, mean_overlap
from invert.tracking.shifts import move_back
from invert.tracking.start import Start, find_brightest, paths_at

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
"""Least share of a single object in frames two apart over that in consecutive ones."""

FEW_GRAINS = 10.0
"""Number of grains of its speckle in a frame below which one of several objects is a remainder of the others."""

LITTLE = 0.5
"""Least part of what another path explains that that of a single object by consecutive frames must explain to be taken."""

ALONE_SHARE = 1.0 / (1.0 + MIN_RELATIVE_POWER)
"""Share of the speckle along one path that leaves too little for another object."""

HALF = 0.5
"""Part of the speckle of consecutive frames below which frames of a distance show another pattern, rather than the same."""

FADING_SIGMA, MAX_WAY_SHARE = 3.0, 0.2
"""Standard errors by which speckle along a path fades before it is said to, and share of a side by which it moves meanwhile at most."""


def find_objects(spectra: np.ndarray, band: Band) -> list[Start]:
    """Return the objects of a capture, the brightest first.

    A single object is followed by consecutive frames.

    Args:
        spectra: (frames, R, C).

    Raises InputError if the whole capture shows no common motion.
    """
    alone = mend(spectra, band, refine_dim_path(spectra, band, find_brightest(spectra, band)))
    middle = max(0, len(spectra) - FRAMES_FOR_NUMBER) // 2
    some = np.s_[middle : middle + FRAMES_FOR_NUMBER]
    lags = _lags_for_others(alone.path[some], spectra[some], central_lobe(band))
    found = _pursue(spectra[some], band, lags, replace(alone, path=alone.path[some])) if lags else [alone]
    if len(spectra) > FRAMES_FOR_NUMBER and not is_alone(found):
        found = _pursue(spectra, band, lags, alone)
    if not is_alone(found):
        return found
    if not _persists(alone, spectra, band):
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
    shares = Shares(spectra, band, light_of_frames(spectra, band))
    for index, lag in enumerate(lags):
        if shares.along(path, lag) > ALONE_SHARE:
            return lags[:index]
    return lags


def _largest_lag(frames: int) -> int:
    return min(MAX_LAG, int(MAX_LAG_SHARE * frames))


def fading_along(spectra: np.ndarray, band: Band, path: np.ndarray) -> tuple[int, float] | None:
    """Return a distance of frames and the part of what consecutive ones share along the path (frames, 2) of a single object that frames so
    far apart still share: the first power of two at which this is clearly less than half, or else the largest distance. If noise leaves no
    room for another object there, or no frames are so far apart, return 1 and the share of all speckle of consecutive frames; None if this
    leaves no room, either."""
    # The overlap of windows far apart is known less well.
    steps = np.abs(path[-1] - path[0]) / (len(path) - 1) / np.array(band.shape)
    lag = max(1, min(_largest_lag(len(spectra)), int(MAX_WAY_SHARE / max(steps.max(), 1e-9))))
    shares = Shares(spectra, band, light_of_frames(spectra, band))
    near = shares.along(path, 1)
    if near <= 0.0:
        return None

    def part_left(apart: int, whole: float) -> tuple[float, float]:
        # Speckle that leaves the view and that which enters it have powers of their own, of cells that are seen once.
        changed = 2.0 * (1.0 - mean_overlap(path[apart:] - path[:-apart], band)) / band.cells
        error = np.hypot(shares.noise(len(spectra) - apart), near * changed**0.5)
        share = near if apart == 1 else max(shares.along(path, apart), 0.0)
        return share / whole, FADING_SIGMA * float(error) / whole

    left, error = part_left(lag, near)
    if left + error >= ALONE_SHARE:
        share, its_error = part_left(1, 1.0)
        return (1, share) if (lag == 1 or left < ALONE_SHARE) and share + its_error < ALONE_SHARE else None
    if left + error < HALF:
        for nearer in (2**power for power in range(1, lag.bit_length())):
            some, its_error = part_left(nearer, near)
            if some + its_error < HALF:
                return nearer, some
    return lag, left


def _pursue(spectra: np.ndarray, band: Band, lags: Sequence[int], alone: Start) -> list[Start]:
    """Return the objects whose paths together make all frames most likely, the brightest first.

    The path of a single object by consecutive frames is one of the candidates, and so is the exact one, with jumps that single frames do
    not show. It stands for the only object unless another path explains more than twice as much: consecutive frames have then shown the
    interference of two.
    """
    several = Several(spectra, band, lags, alone.path)
    candidates = [alone.path]
    with suppress(InputError):  # nothing in common across a boundary, which several objects can show as well
        candidates.append(follow_over_jumps(spectra, band, alone).path)
    of_one = max(several.rise([path]) for path in candidates)
    candidates += _sought(spectra, several.band, lags, [])
    known = several.settle([max(candidates, key=lambda path: several.rise([path]))])
    while (more := several.add_object(known, candidates + _sought(spectra, several.band, lags, known))) is not None:
        followed = follow_several(spectra, band, _objects_at(several, spectra, band, lags, more))
        if min(replace(band, signal=one.power).cells for one in followed) < FEW_GRAINS:
            break
        known = [one.path for one in followed]
    together = several.rise(known)
    if len(known) == 1 and of_one >= min(LITTLE * together, together - several.cells):
        return [alone]
    return sorted(_objects_at(several, spectra, band, lags, known), key=lambda one: -one.share)


def _objects_at(
    several: Several, spectra: np.ndarray, band: Band, lags: Sequence[int], paths: Sequence[np.ndarray]
) -> list[Start]:
    """Return objects with their paths, powers as a share of that of all speckle, and significance."""
    shares, found = Shares(spectra, several.band), []
    for path, power in zip(paths, several.powers(paths) * several.band.power / band.power, strict=True):
        clear = max(shares.along(path, lag) / shares.noise(len(spectra) - lag) for lag in lags)
        found.append(Start(path, clear, float(power), max(1, (len(spectra) - lags[0]) // BLOCKS[0]), lags[0]))
    return found


def _sought(spectra: np.ndarray, band: Band, lags: Sequence[int], known: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the paths of candidates at some distances of frames, in what known objects leave of the spectra: all but the mean along their
    paths in blocks of twice the distance. Blocks of pairs have different lengths."""
    found = []
    for lag in lags:
        left, lengths = spectra, dict.fromkeys(max(1, (len(spectra) - lag) // blocks) for blocks in BLOCKS)
        for path in known:
            left = _changes_along(left, band, path, 2 * lag)
        found += [one.path for length in lengths for one in paths_at(left, band, lag, length)[0]]
    return found


def _changes_along(spectra: np.ndarray, band: Band, path: np.ndarray, length: int) -> np.ndarray:
    """Return spectra (frames, R, C) less what moves along a path (frames, 2) in blocks of about a number of frames."""
    moved = move_back(spectra, band, path)
    for block in np.array_split(moved, max(1, len(path) // length)):  # views
        block -= block.mean(0)
    return move_back(moved, band, -path)


def is_alone(found: Sequence[Start]) -> bool:
    """Return whether the only object is the one by consecutive frames."""
    return len(found) == 1 and found[0].lag == 1


def _persists(alone: Start, spectra: np.ndarray, band: Band) -> bool:
    """Return whether frames two apart show a single object at its path, too."""
    if len(spectra) < 4:
        return True
    shares = Shares(spectra, band)
    near, far = (shares.along(alone.path, lag) for lag in (1, 2))
    return far > MIN_PERSISTENCE * near
