"""Jumps of a path: frames are missing, something was pushed, or the object turned back.

An approximate path of blocks of frames goes on as if nothing had happened. `mend` finds jumps between single frames. Where these are too
dim, `follow_over_jumps` compares sums of frames on both sides of a boundary, moved back along the exact path.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from correlograph.errors import InputError
from invert.tracking.band import Band
from invert.tracking.boundaries import MAX_LOW, MIN_HIGH, Boundaries, boundaries_along
from invert.tracking.follow import Followed, follow
from invert.tracking.light import light_of_frames
from invert.tracking.maxima import highest
from invert.tracking.parts import on_all_cores
from invert.tracking.shares import MIN_OVERLAP
from invert.tracking.shifts import MIN_SIGNIFICANCE, fold, move_back, overlap_share
from invert.tracking.start import Start, replace_path

USUAL_OF_SOME = 0.75
"""Quantile of the likeness at the best displacement at some boundaries that counts as usual."""

BOUNDARIES_FOR_USUAL = 16
"""Number of these boundaries. They tell the usual likeness where the path jumps at most boundaries."""

MAX_SIGMA = 3.0
"""Significance of the likeness of clear frames below which they have nothing in common along a path."""

MIN_USUAL = 0.7
"""Least usual likeness of sums that may break: of longer sums, whose illumination changes within, some have little in common anyway."""

GROUPS = (4, 8, 16)
"""Numbers of frames on each side of a boundary that are added where fewer are too dim."""

ROUNDS = 3

APART_GRAINS = 3.0
"""Least way off an exact path that is a jump, in rms radii of a grain."""


def mend(spectra: np.ndarray, band: Band, start: Start) -> Start:
    """Return an object with the jumps of its path from one frame to the next, from spectra (frames, R, C)."""
    at_path = boundaries_along(spectra, band, light_of_frames(spectra, band), start.path, 1)
    if at_path.is_continuous:
        return replace(start, is_continuous=True)
    where, jumps, _ = _jumps(spectra, band, start.path, at_path)
    if not len(where):
        return start
    return replace(replace_path(start, spectra, band, _jump(start.path, where, jumps)), jumps=len(where))


def follow_over_jumps(spectra: np.ndarray, band: Band, start: Start) -> Followed:
    """Return the exact path of a single object, with jumps that single frames are too dim to show.

    Raises InputError if clear frames on both sides of a boundary have nothing in common.
    """
    found = follow(spectra, band, start)
    if start.is_continuous or not found.significance:
        return found
    along = partial(boundaries_along, spectra, band, light_of_frames(spectra, band))
    groups = [one for one in GROUPS if 4 * one <= len(spectra)]
    for group in groups:
        for _ in range(ROUNDS):
            at_path = along(found.path, group)
            if at_path.is_continuous:
                return found
            where, jumps, heights = _jumps(spectra, band, found.path, at_path)
            # An exact path strays by less, and a jump is seen at boundaries beside its own, too.
            far = np.linalg.norm(jumps, axis=1) > APART_GRAINS * band.grain_pixels
            chosen = _separate(where[far], heights[far], group)
            if not len(chosen):
                break
            path = _jump(found.path, where[far][chosen], jumps[far][chosen])
            found = follow(spectra, band, replace(start, path=path))
    for group in groups:
        at_path = along(found.path, group)
        if at_path.usual > MIN_USUAL and at_path.show_breaks.mean() >= 0.5:
            _check_sums(at_path)
            break
    return found


def check_continuity(spectra: np.ndarray, band: Band, path: np.ndarray) -> None:
    """Raise InputError if there is a boundary across which clear frames have nothing in common along the path (frames, 2) of the only
    object: neither the two frames beside it, nor two on each side, of which one may be dark. Of frames that are too dim, two or four on
    each side are compared; the path is then that at which they seem to have most in common by noise."""
    if len(path) < 4:
        return
    along = partial(boundaries_along, spectra, band, light_of_frames(spectra, band), path)
    single, double = along(1), along(2)
    if single.show_breaks.mean() >= 0.5:
        is_broken = np.maximum(single.alike * single.scale, double.alike * double.scale) < MAX_SIGMA
        is_broken &= double.show_breaks
    else:
        several = double if double.is_clear else along(4)
        is_broken = several.are_clear & (several.alike < MAX_LOW * several.usual)
        is_broken &= single.alike * single.scale < MAX_SIGMA
    if is_broken.any():
        raise _broken_after(int(np.argmax(is_broken)) + 1)


def _broken_after(frame: int) -> InputError:
    expected, remedy = (
        "speckle that continues from frame to frame",
        "track the frames before and after apart, without dark ones",
    )
    return InputError("frames", expected, f"nothing in common across the boundary after frame {frame}", remedy)


def _jumps(spectra: np.ndarray, band: Band, path: np.ndarray, at_path: Boundaries) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the boundaries (k,) at which a path jumps, the jumps (k, 2), and the likeness of the frames with them, (k,)."""
    steps, group, weight = np.diff(path, axis=0), at_path.group, at_path.weight

    def search(boundary: int) -> np.ndarray:
        first, last = max(0, boundary + 1 - group), min(len(spectra), boundary + 1 + group)
        moved = move_back(spectra[first:last], band, path[first:last])
        place, height = highest(
            moved[: boundary + 1 - first].sum(0).conj() * moved[boundary + 1 - first :].sum(0), band, weight
        )
        whole = fold(place + steps[boundary], band)
        overlap = overlap_share(np.stack([steps[boundary], whole]), band)
        sigma = height / weight.deviation / np.sqrt((boundary + 1 - first) * (last - boundary - 1))
        alike = sigma / at_path.scale[boundary] * overlap[0] / max(overlap[1], MIN_OVERLAP)
        return np.array([*(whole - steps[boundary]), alike, sigma])

    def look(boundaries: np.ndarray) -> np.ndarray:
        return np.array(on_all_cores(search, boundaries)).reshape(-1, 4)

    some = np.unique(np.linspace(0, len(steps) - 1, BOUNDARIES_FOR_USUAL).astype(int))
    most = np.maximum(at_path.alike[some], look(some)[:, 2])
    usual = max(at_path.usual, np.quantile(most, USUAL_OF_SOME))
    # Where even sides that share all their speckle are not significant, the highest of all displacements is noise.
    low = np.flatnonzero((at_path.alike < MAX_LOW * usual) & (min(usual, 1.0) * at_path.scale > MIN_SIGNIFICANCE))
    found = look(low)
    is_jump = (found[:, 2] > MIN_HIGH * usual) & (found[:, 3] > MIN_SIGNIFICANCE)
    return low[is_jump], found[is_jump, :2], found[is_jump, 2]


def _jump(path: np.ndarray, where: np.ndarray, jumps: np.ndarray) -> np.ndarray:
    """Return a path that jumps after some frames."""
    steps = np.diff(path, axis=0)
    steps[where] += jumps
    return np.concatenate([path[:1], path[0] + np.cumsum(steps, 0)])


def _separate(where: np.ndarray, heights: np.ndarray, group: int) -> np.ndarray:
    """Return the indices of the highest of all boundaries that are closer to each other than two groups."""
    chosen: list[int] = []
    for index in np.argsort(-heights):
        if all(abs(where[index] - where[other]) >= 2 * group for other in chosen):
            chosen.append(int(index))
    return np.array(chosen, int)


def _check_sums(at_path: Boundaries) -> None:
    """Raise InputError if frames share nothing across a boundary, while those on each side of it do."""
    group, clear = at_path.group, MIN_HIGH * at_path.usual
    nothing = np.minimum(MAX_SIGMA / at_path.scale, MAX_LOW * at_path.usual)
    is_broken = (at_path.show_breaks & (at_path.alike < nothing))[group:-group]
    is_broken &= (at_path.alike[: -2 * group] > clear) & (at_path.alike[2 * group :] > clear)
    if is_broken.any():
        raise _broken_after(int(np.argmax(is_broken)) + group + 1)
