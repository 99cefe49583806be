"""Where the speckle of an object jumps: frames are missing, something was pushed, or the object turned back.

An approximate path of blocks of frames goes on as if nothing had happened. A jump is where the frames before and after a boundary, moved
back along the path, have more in common at another displacement than at none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from correlograph.errors import InputError
from invert.tracking.parts import on_all_cores, sum_over_rows
from invert.tracking.shifts import APART_GRAINS, MIN_SIGNIFICANCE, correlate, heights_at, move_back, refine, weight_of
from invert.tracking.spectra import Band
from invert.tracking.start import Start, share_along

MAX_LOW, MIN_HIGH = 0.3, 0.6
"""Share of what the frames at most boundaries have in common below which a jump is sought, and above which it is found. The interference of
two objects lowers it to any value, but is nowhere as high as the speckle of one."""

SURE = 1.5
"""Factor between `MIN_SIGNIFICANCE` and that of a jump: the speckle of other frames in a sum is noise, too."""

SAMPLED = 16
"""Number of boundaries that tell what frames have in common where the path may jump at most of them."""

GROUPS = (1, 4, 16)
"""Numbers of frames on each side of a boundary that are compared."""

MAX_JUMPS = 16
"""Number of jumps that are sought by more than one frame on each side."""


def mend(spectra: np.ndarray, band: Band, start: Start) -> Start:
    """Return an object with the jumps of its path, from spectra (frames, R, C).

    Raises InputError if frames on both sides of a boundary are clear, but have nothing in common.
    """
    path, weight, count = start.path, weight_of(band, 0.0), 0
    for group in (one for one in GROUPS if 4 * one <= len(spectra)):
        for _ in range(MAX_JUMPS):
            at_path = _in_common(spectra, band, path, group)
            some = np.unique(np.linspace(0, len(at_path) - 1, SAMPLED).astype(int))
            highest = np.maximum(at_path[some], _jumps(spectra, band, path, some, group)[1])
            usual = float(max(np.quantile(at_path, 0.9), np.quantile(highest, 0.75)))
            if MIN_HIGH * usual < SURE * MIN_SIGNIFICANCE * weight.deviation:
                break
            low = np.flatnonzero(at_path < MAX_LOW * usual)
            jumps, heights = _jumps(spectra, band, path, low, group)
            overlap = np.prod(1.0 - np.abs(jumps) / np.array(band.shape), axis=1)
            is_jump = heights > MIN_HIGH * usual * np.maximum(overlap, 0.7)
            if group > 1:  # an approximate path strays, and a jump is seen at boundaries beside its own, too
                is_jump &= np.linalg.norm(jumps, axis=1) > APART_GRAINS * band.grain_pixels
                is_jump &= heights == heights.max(initial=0.0, where=is_jump)
            for boundary, jump in zip(low[is_jump], jumps[is_jump], strict=True):
                count += 1
                path = path + np.where(np.arange(len(path))[:, None] > boundary, jump, 0.0)
            if not is_jump.any() and group > 1:
                _check_continuity(at_path, group)
            if group == 1 or not is_jump.any():
                break
    if not count:
        return start
    share = min(1.0, share_along(spectra, band, path, 1))
    significance = share * weight.full * (len(path) - 1) ** 0.5 / weight.deviation
    return replace(start, path=path, significance=significance, share=share, jumps=count)


def _check_continuity(at_path: np.ndarray, group: int) -> None:
    """Raise InputError if frames share nothing across a boundary, while those on each side of it do."""
    inside, clear = at_path[group:-group], MIN_HIGH * np.quantile(at_path, 0.9)
    is_broken = (inside < 0.1 * clear) & (at_path[: -2 * group] > clear) & (at_path[2 * group :] > clear)
    if is_broken.any():
        last = int(np.argmax(is_broken)) + group + 1
        expected, remedy = "speckle that continues from frame to frame", "track the frames before and after apart"
        raise InputError("frames", expected, f"nothing in common across the boundary after frame {last}", remedy)


def _in_common(spectra: np.ndarray, band: Band, path: np.ndarray, group: int) -> np.ndarray:
    """Return the cross-correlations (frames - 1,) of the `group` frames before and after each boundary, moved back along a path, in the
    unit of the deviation of a pair."""
    weight = weight_of(band, 0.0)

    def heights(rows: slice) -> np.ndarray:
        before, after = _sums(spectra[:, rows], band.part(rows), path, group)
        return heights_at(before.conj() * after, band.part(rows), weight.part(rows), np.zeros((len(before), 2)))

    return sum_over_rows(heights, spectra) / _pairs(len(spectra), group) ** 0.5


def _jumps(
    spectra: np.ndarray, band: Band, path: np.ndarray, boundaries: np.ndarray, group: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacements (k, 2) at which the frames before and after boundaries have most in common, and how much."""
    weight, pairs = weight_of(band, 0.0), _pairs(len(spectra), group)

    def jump(boundary: int) -> np.ndarray:
        first, last = max(0, boundary + 1 - group), min(len(spectra), boundary + 1 + group)
        moved = move_back(spectra[first:last], band, path[first:last])
        cross = moved[: boundary + 1 - first].sum(0).conj() * moved[boundary + 1 - first :].sum(0)
        found, pitch = correlate(cross, band, weight)
        place = np.array(np.unravel_index(int(found.argmax()), found.shape))
        start = ((place + np.array(found.shape) // 2) % found.shape - np.array(found.shape) // 2) * pitch
        exact, height = refine(cross[None], band, weight, start[None])
        return np.array([*exact[0], height[0] / pairs[boundary] ** 0.5])

    found = np.array(on_all_cores(jump, boundaries)).reshape(-1, 3)
    return found[:, :2], found[:, 2]


def _sums(spectra: np.ndarray, band: Band, path: np.ndarray, group: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums of the `group` frames before and after each boundary, moved back along a path, (frames - 1, R, C) each."""
    moved = move_back(spectra, band, path)
    if group == 1:
        return moved[:-1], moved[1:]
    total = np.concatenate([np.zeros_like(moved[:1]), np.cumsum(moved, 0)])
    boundary = np.arange(1, len(moved))
    first, last = np.maximum(boundary - group, 0), np.minimum(boundary + group, len(moved))
    return total[boundary] - total[first], total[last] - total[boundary]


def _pairs(frames: int, group: int) -> np.ndarray:
    """Return the number of pairs of frames across each boundary, (frames - 1,)."""
    boundary = np.arange(1, frames)
    return np.minimum(boundary, group) * np.minimum(frames - boundary, group)
