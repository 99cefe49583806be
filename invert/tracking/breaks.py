"""Jumps of a path: frames are missing, something was pushed, or the object turned back.

An approximate path of blocks of frames goes on as if nothing had happened. `mend` finds jumps between single frames. Where these are too
dim, `follow_over_jumps` compares sums of frames on both sides of a boundary, moved back along the exact path.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from correlograph.errors import InputError
from invert.tracking.band import Band
from invert.tracking.follow import Followed, follow
from invert.tracking.maxima import highest
from invert.tracking.parts import on_all_cores, sum_over_rows
from invert.tracking.shifts import MIN_SIGNIFICANCE, Weight, fold, move_back, overlap_share, weight_of
from invert.tracking.start import Start, share_along

MAX_LOW, MIN_HIGH = 0.3, 0.45
"""Likeness of frames, over the usual one, below which a jump is sought, and above which it is found. The interference of two objects
lowers it to any value, but is nowhere as high as the speckle of one."""

USUAL, USUAL_OF_SOME = 0.9, 0.75
"""Quantiles of the likeness that count as usual: along the path at all boundaries, and at the best displacement at some of them."""

BOUNDARIES_FOR_USUAL = 16
"""Number of these boundaries. They tell the usual likeness where the path jumps at most boundaries."""

FALSE_ALARM = 0.01
"""Probability that noise alone looks like light that changes from frame to frame."""

MAX_LIGHT_NOISE = 0.25
"""Variance of the light that is measured in one frame, over its square, above which it is taken to be the same in all."""

NOTHING = 0.05
"""Likeness over the usual one below which frames have nothing in common."""

MAX_SIGMA = 3.0
"""Significance of the likeness of clear frames below which they have nothing in common along a path."""

BREAK_SIGMA = 8.0
"""Least significance of the usual likeness at which its absence is no noise: below `MAX_SIGMA` once in 10^6 boundaries."""

MIN_USUAL = 0.7
"""Least usual likeness of sums that may break: of longer sums, whose illumination changes within, some have little in common anyway."""

GROUPS = (4, 8, 16)
"""Numbers of frames on each side of a boundary that are added where fewer are too dim."""

ROUNDS = 3

APART_GRAINS = 3.0
"""Least way off an exact path that is a jump, in rms radii of a grain."""


class Boundaries(NamedTuple):
    """Likeness of the frames before and after each boundary along a path.

    Attributes:
        group: number of frames on each side.
        alike: over the light of both sides and the overlap of their windows, (frames - 1,).
        scale: height of the cross-correlation for an `alike` of 1, in standard deviations, (frames - 1,).
        weight: of the cross-spectra of the sums of both sides.
    """

    group: int
    alike: np.ndarray
    scale: np.ndarray
    weight: Weight

    @property
    def usual(self) -> float:
        """Likeness at nearly all boundaries."""
        return float(np.quantile(self.alike, USUAL))

    @property
    def are_clear(self) -> np.ndarray:
        """Whether each boundary would show a jump, bool (frames - 1,)."""
        return MIN_HIGH * self.usual * self.scale > MIN_SIGNIFICANCE

    @property
    def is_clear(self) -> bool:
        """Whether most boundaries would show a jump."""
        return float(self.are_clear.mean()) >= 0.5

    @property
    def show_breaks(self) -> np.ndarray:
        """Whether each boundary would show that its sides share nothing, bool (frames - 1,)."""
        return (self.usual > MIN_USUAL) & (self.usual * self.scale > BREAK_SIGMA)

    @property
    def is_continuous(self) -> bool:
        """Whether no boundary shows a jump, although most would."""
        return self.is_clear and float(self.alike.min()) >= MAX_LOW * self.usual


def mend(spectra: np.ndarray, band: Band, start: Start) -> Start:
    """Return an object with the jumps of its path from one frame to the next, from spectra (frames, R, C)."""
    at_path = _boundaries(spectra, band, start.path, 1)
    if at_path.is_continuous:
        return replace(start, is_continuous=True)
    where, jumps, _ = _jumps(spectra, band, start.path, at_path)
    if not len(where):
        return start
    path = _jump(start.path, where, jumps)
    share = min(1.0, share_along(spectra, band, path, 1))
    weight = weight_of(band, 0.0)
    significance = share * weight.full * (len(path) - 1) ** 0.5 / weight.deviation
    return replace(start, path=path, significance=significance, share=share, jumps=len(where))


def follow_over_jumps(spectra: np.ndarray, band: Band, start: Start) -> Followed:
    """Return the exact path of a single object, with jumps that single frames are too dim to show.

    Raises InputError if clear frames on both sides of a boundary have nothing in common.
    """
    found = follow(spectra, band, start)
    if start.is_continuous or not found.significance:
        return found
    clear = None
    for group in (one for one in GROUPS if 4 * one <= len(spectra)):
        for _ in range(ROUNDS):
            at_path = _boundaries(spectra, band, found.path, group)
            if at_path.is_continuous:
                break
            where, jumps, heights = _jumps(spectra, band, found.path, at_path)
            # An exact path strays by less, and a jump is seen at boundaries beside its own, too.
            far = np.linalg.norm(jumps, axis=1) > APART_GRAINS * band.grain_pixels
            chosen = _separate(where[far], heights[far], group)
            if not len(chosen):
                break
            path = _jump(found.path, where[far][chosen], jumps[far][chosen])
            found, clear = follow(spectra, band, replace(start, path=path)), None
        else:
            continue
        clear = at_path if at_path.show_breaks.mean() >= 0.5 else clear
        if at_path.is_continuous:
            break
    if clear is not None:
        _check_sums(clear)
    return found


def check_continuity(spectra: np.ndarray, band: Band, path: np.ndarray) -> None:
    """Raise InputError if there is a boundary across which clear frames have nothing in common along the path (frames, 2) of the only
    object: neither the two frames beside it, nor two on each side, of which one may be dark. Of frames that are too dim, two or four on
    each side are compared; the path is then that at which they seem to have most in common by noise."""
    if len(path) < 4:
        return
    single, double = (_boundaries(spectra, band, path, group) for group in (1, 2))
    if single.show_breaks.mean() >= 0.5:
        is_broken = np.maximum(single.alike * single.scale, double.alike * double.scale) < MAX_SIGMA
        is_broken &= single.show_breaks
    else:
        several = double if double.is_clear else _boundaries(spectra, band, path, 4)
        is_broken = several.are_clear & (several.alike < MAX_LOW * several.usual)
    if is_broken.any():
        raise _broken_after(int(np.argmax(is_broken)) + 1)


def _broken_after(frame: int) -> InputError:
    expected, remedy = (
        "speckle that continues from frame to frame",
        "track the frames before and after apart, without dark ones",
    )
    return InputError("frames", expected, f"nothing in common across the boundary after frame {frame}", remedy)


def _boundaries(spectra: np.ndarray, band: Band, path: np.ndarray, group: int) -> Boundaries:
    """Return the likeness of the `group` frames before and after each boundary along a path."""
    weight = _weight_of_sums(spectra, band, path, group)

    def measure(rows: slice) -> np.ndarray:
        before, after = _sums(move_back(spectra[:, rows], band.part(rows), path), group)
        return np.vecdot(before * weight.values[rows].astype(np.float32), after).real.sum(1).astype(np.float64)

    before, after = _sums(_light(spectra, band)[:, None], group)
    counts = _sums(np.ones((len(path), 1)), group)
    overlap = np.maximum(overlap_share(np.diff(path, axis=0), band), NOTHING)
    expected = weight.full * (before * after)[:, 0] * overlap
    deviation = weight.deviation * np.sqrt(counts[0] * counts[1])[:, 0]
    return Boundaries(group, sum_over_rows(measure, spectra) / expected, expected / deviation, weight)


def _light(spectra: np.ndarray, band: Band) -> np.ndarray:
    """Return the amplitude of the speckle in each frame, (frames,), over that of the band, if its changes are no noise.

    The weights leave out what grows with the floor, because the number of photons in a frame is random, too.
    """
    total = np.maximum(band.signal + band.floor, 1e-300)
    of_signal, of_floor = (band.counts * one / total**2 for one in (band.signal, band.floor))
    weights = of_signal - of_floor * (of_signal * band.floor).sum() / max(float((of_floor * band.floor).sum()), 1e-300)
    full = max(float((weights * band.signal).sum()), 1e-300)

    def powers(rows: slice) -> np.ndarray:
        return (np.abs(spectra[:, rows]) ** 2 * weights[rows].astype(np.float32)).sum((1, 2), np.float64)

    found = (sum_over_rows(powers, spectra) - (weights * band.floor).sum()) / full
    noise = 2.0 * band.noise_gain * (weights**2 / np.maximum(band.counts, 1.0) * total**2).sum() / full**2
    variance, noisy = float(found.var(ddof=1)), chi2.isf(FALSE_ALARM, len(found) - 1) / (len(found) - 1)
    if noise > MAX_LIGHT_NOISE or variance < noise * noisy:
        return np.ones(len(found))
    usual = max(float(np.median(found)), NOTHING)
    return np.sqrt(np.maximum(usual + (1.0 - noise / variance) * (found - usual), NOTHING * usual))


def _weight_of_sums(spectra: np.ndarray, band: Band, path: np.ndarray, group: int) -> Weight:
    """Return the weight of cross-spectra of sums of `group` frames along a path, in which their common speckle counts as that of single
    frames does. It adds up to more than the noise of the frames, and what two sums do not share is noise, too."""
    of_frame = weight_of(band, 0.0)
    if group == 1:
        return of_frame

    def power(rows: slice) -> np.ndarray:
        before = _sums(move_back(spectra[:, rows], band.part(rows), path), group)[0][group - 1 :]
        return (np.vecdot(before, before, axis=0).real * of_frame.values[rows]).sum()

    of_sums = float(sum_over_rows(power, spectra)) / (len(path) - group) / group
    gain = (of_sums - (of_frame.values * band.floor).sum()) / of_frame.full
    gain = float(np.clip(gain, 1.0, group))
    found = weight_of(replace(band, signal=gain * band.signal), 0.0)
    scale = gain * of_frame.full / found.full
    return replace(found, values=scale * found.values, deviation=scale * found.deviation, full=of_frame.full)


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
        alike = sigma / at_path.scale[boundary] * overlap[0] / max(overlap[1], NOTHING)
        return np.array([*(whole - steps[boundary]), alike, sigma])

    def look(boundaries: np.ndarray) -> np.ndarray:
        return np.array(on_all_cores(search, boundaries)).reshape(-1, 4)

    some = np.unique(np.linspace(0, len(steps) - 1, BOUNDARIES_FOR_USUAL).astype(int))
    most = np.maximum(at_path.alike[some], look(some)[:, 2])
    usual = max(at_path.usual, np.quantile(most, USUAL_OF_SOME))
    low = np.flatnonzero(at_path.alike < MAX_LOW * usual)
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


def _sums(values: np.ndarray, group: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums of the `group` entries of (n, ...) before and after each boundary, (n - 1, ...) each."""
    if group == 1:
        return values[:-1], values[1:]
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, 0)])
    boundary = np.arange(1, len(values))
    first, last = np.maximum(boundary - group, 0), np.minimum(boundary + group, len(values))
    return total[boundary] - total[first], total[last] - total[boundary]
