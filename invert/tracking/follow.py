"""Exact path of one object: each frame is registered to the sum of the frames around it, moved to their own positions.

The speckle stays the same while the object moves by a fraction of a grain of its illumination. Within this reach, the sum of M frames shows
it with M times less noise than one, and the error of a frame's position approaches that for a known pattern. Frames too dim to be
registered alone are summed in groups of two, four and so on, as they move.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import interp1d
from scipy.linalg import solveh_banded
from scipy.special import erf

from invert.tracking.parts import sum_over_rows
from invert.tracking.shifts import MIN_SIGNIFICANCE, Weight, derivatives, moments, move_back, weight_of, window_slopes
from invert.tracking.spectra import Band
from invert.tracking.start import Start

MIN_GROUP_SIGNIFICANCE = 5.0
"""Median significance of a group of frames in its surroundings from which it is registered on its own."""

MAX_REACH = 16
"""Number of groups on each side, at most, to which one is registered."""

MIN_LIKENESS = 0.6
"""Share of the common speckle of neighbours that groups must still have in common."""

PAIRS = 48
"""Pairs of groups from which a likeness is measured."""

MAX_FADING = 0.6
"""Maximum of `Followed.fading`; it limits the correction for an open shutter to a quarter of the path."""

SHUTTER_ERROR = 0.1
"""Relative error of this correction, because the likeness is not quite a Gaussian."""

WINDOW_ERROR = 0.35
"""Relative error of what the window draws paths by, where grains are large in a frame (docs/tracking.md, "Limits")."""

ROUNDS = 8
CONVERGED_GRAINS = 0.01
"""Largest change of a displacement between neighbours, in radii of a grain, at which a registration ends."""


@dataclass(frozen=True)
class Followed:
    """Path of an object.

    Attributes:
        path: position of its speckle in each frame from the first, (frames, 2) pixels.
        error: standard error of each position of the speckle, (frames, 2).
        frames_per_group: number of frames that were registered together, or distance of positions between which the path is straight.
        power: power of its speckle, (R, C).
        significance: median significance of a group in its surroundings; 0 where none was measured.
        bend_error: standard error of a second difference of the path, (2,); zero for an approximate path.
        fading: square of the way from frame to frame over that in which the likeness of frames falls to 1 / e.
        in_common: share of all power that frames 1, 2, ... apart have in common by one of several objects.
    """

    path: np.ndarray
    error: np.ndarray
    frames_per_group: int
    power: np.ndarray
    significance: float = 0.0
    bend_error: np.ndarray = field(default_factory=lambda: np.zeros(2))
    fading: float = 0.0
    in_common: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def for_open_shutter(self, share: float) -> Followed:
        """Return the path for a shutter that is open for a share of the interval between frames. The end of one exposure is then closer to
        the beginning of the next than their middles are, and more alike, which draws displacements towards zero by the third of the fading.

        The fading itself appears smaller by the same share, because likenesses are means over both exposures.
        """
        fading = min(self.fading, MAX_FADING)
        longer = fading * (1.0 + fading * share**2 / 3.0) * share**2 / 3.0
        return replace(self, path=self.path * (1.0 + longer), error=np.hypot(self.error, SHUTTER_ERROR * longer * self.path))


def follow(spectra: np.ndarray, band: Band, start: Start) -> Followed:
    """Return the path of a single object near an approximate one, from spectra (frames, R, C); where it cannot be made exact, that one."""
    best, length, longest = None, 1, 1
    while best is None or (best.significance < MIN_GROUP_SIGNIFICANCE and length <= longest):
        found, reach = _follow_groups(spectra, band, start.path, length)
        longest = reach if length == 1 else longest
        if best is None or found.significance > best.significance:
            best = found
        length *= 2
    if best.significance < MIN_GROUP_SIGNIFICANCE:
        return approximate(start, band)
    return replace(best, fading=_fading(likeness(spectra, band, best.path)[:2]))


def approximate(start: Start, band: Band) -> Followed:
    """Return an approximate path as it is.

    Its error is the radius of a grain, or the sum of the errors of all blocks: the displacement of a block over `lag` frames is known to
    that radius over the least significance.
    """
    blocks = np.arange(len(start.path)) / start.frames_per_block
    of_block = start.frames_per_block / (start.lag * MIN_SIGNIFICANCE)
    error = band.grain_pixels * np.maximum(1.0, of_block * blocks**0.5)
    error[0] = 0.0
    return Followed(start.path, np.stack([error, error], 1), start.frames_per_block, band.signal)


def _fading(alike: np.ndarray) -> float:
    """Return the fading from the first and the last of the likenesses exp(-fading k^2) of frames k = 1, 2, ... apart."""
    if len(alike) < 2 or alike[0] <= 0.0:
        return 0.0
    return float(np.log(1.0 / np.clip(alike[-1] / alike[0], 1e-3, 1.0)) / (len(alike) ** 2 - 1.0))


def _follow_groups(spectra: np.ndarray, band: Band, path: np.ndarray, length: int) -> tuple[Followed, int]:
    """Return the path from groups of `length` frames, and the largest distance of groups that were compared.

    Within a group, the approximate path gives the motion about its mean.
    """
    groups = np.array_split(np.arange(len(path)), max(2, len(path) // length))
    middles = np.array([group.mean() for group in groups])
    means = np.stack([path[group].mean(0) for group in groups])
    sums = spectra
    if len(groups) < len(path):
        sums = np.stack([move_back(spectra[group], band, path[group] - path[group].mean(0)).sum(0) for group in groups])
    of_group = replace(band, signal=band.signal * length**2, floor=band.floor * length)
    places, error, reach, of_pair, significance = _register(sums, of_group, means)
    numbers = np.arange(len(path))
    found = path + np.stack([_interpolate(numbers, middles, (places - means)[:, axis]) for axis in (0, 1)], 1)
    errors = np.stack([np.interp(numbers, middles, error[:, axis]) for axis in (0, 1)], 1)
    from_first = np.hypot(errors, errors[0])
    from_first[0] = 0.0
    # Between the middles of groups, the path is straight.
    bend_error = np.sqrt(of_pair * _bend_over_pair(reach) / (2.0 * length**3 if length > 1 else 1.0))
    return Followed(found - found[0], from_first, length, band.signal, significance, bend_error), reach


def _register(sums: np.ndarray, band: Band, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, int, np.ndarray, float]:
    """Return positions of groups (n, 2), their standard errors, the largest distance of the pairs, the variance of the displacement of a
    pair (2,), and the median significance.

    All pairs within the reach are registered together by Gauss-Newton steps on the sum of their cross-correlations. All pairs have
    the same curvature, so that what the noise of a pair moves its two members by cancels beyond them; own curvatures would add it up twice
    along the path.
    """
    count = len(sums)
    numbers = np.arange(count)
    for _ in range(ROUNDS):
        alike = likeness(sums, band, places)
        reach = reach_of(alike)
        pairs = np.minimum(numbers, reach) + np.minimum(numbers[::-1], reach)
        usual = max(1, int(np.median(pairs)))
        weight = weight_of(band, float(np.clip(alike[0], 0.05, 1.0)), usual)
        height, slope, curvature = derivatives(_pull_of_surroundings(sums, band, places, reach, weight))
        inverse = np.linalg.inv(-curvature.sum(0) / pairs.sum())
        correction = _solve(slope @ inverse, reach)
        places = places + correction
        if np.abs(np.diff(correction, axis=0)).max() < CONVERGED_GRAINS * band.grain_pixels:
            break
    of_pair = np.diag(inverse @ weight.slope_variance @ inverse) / usual
    variance = of_pair / pairs[:, None]
    # Over distances beyond the reach, errors add up like resistances of a chain in which each member is joined to its neighbours.
    walked = numbers[:, None] / np.sum(np.arange(1.0, reach + 1.0) ** 2) * of_pair
    walked = walked + _walk_by_change(places, alike, band)
    significance = float(np.median(height)) / weight.deviation
    # Where grains are large in a frame, this pull is known to first order only, and would grow with each round.
    pull = weight.full / usual * _pull_of_windows(places, band, alike[:reach]) @ weight.tilt.T
    drawn = _solve(pull @ inverse, reach)
    return places - drawn, np.sqrt(variance + walked + (WINDOW_ERROR * drawn) ** 2), reach, of_pair, significance


def _pull_of_surroundings(sums: np.ndarray, band: Band, places: np.ndarray, reach: int, weight: Weight) -> np.ndarray:
    """Return the moments (n, 3, 3) at zero shift of the cross-correlations of groups, moved back to their places, with the sums of all
    others within the reach."""
    count = len(sums)
    low, high = (np.clip(np.arange(count) + side, 0, count) for side in (-reach, reach + 1))

    def pull(rows: slice) -> np.ndarray:
        part, values = band.part(rows), weight.part(rows).values
        moved = move_back(sums[:, rows], part, places)
        total = np.zeros((count + 1, *moved.shape[1:]), moved.dtype)
        np.cumsum(moved, 0, out=total[1:])
        around = total[high] - total[low] - moved
        return moments(around.conj() * moved * values.astype(np.float32), part, np.zeros((count, 2)))

    return sum_over_rows(pull, sums)


def _pull_of_windows(places: np.ndarray, band: Band, alike: np.ndarray) -> np.ndarray:
    """Return by how much the logarithms of the overlaps of windows fall at the distances of places (n, 2), summed over the neighbours of
    each with the likenesses as weights, (n, 2): the windows stay where they are, and draw the places towards each other."""
    pull = np.zeros_like(places)
    for step, likeness_ in enumerate(alike, start=1):
        slopes = likeness_ * window_slopes(places[step:] - places[:-step], band)
        pull[step:] += slopes
        pull[:-step] -= slopes
    return pull


def _solve(slopes: np.ndarray, reach: int) -> np.ndarray:
    """Return corrections (n, 2) of positions, whose differences over all pairs within the reach add up to the slopes (n, 2); 0 for the
    first."""
    count = len(slopes)
    bands = np.zeros((reach + 1, count))
    for step in range(1, min(reach + 1, count)):
        bands[step, : count - step] = -1.0
        bands[0, : count - step] += 1.0
        bands[0, step:] += 1.0
    bands[0] += 1e-6  # what no pair joins stays; the slopes add up to zero, and the mean with them
    found = solveh_banded(bands, slopes, lower=True)
    return found - found[0]


def _bend_over_pair(reach: int) -> float:
    """Return the variance of a second difference of positions over that of the displacement of a pair, far from the ends."""
    count = 6 * reach + 3
    apart = np.abs(np.arange(count)[:, None] - np.arange(count))
    joined = ((apart > 0) & (apart <= reach)).astype(float)
    bend = np.zeros(count)
    bend[count // 2 - 1 : count // 2 + 2] = 1.0, -2.0, 1.0
    return float(bend @ np.linalg.pinv(np.diag(joined.sum(0)) - joined) @ bend)


def reach_of(alike: np.ndarray) -> int:
    """Return the number of distances, at least 1, over which the likeness stays above `MIN_LIKENESS` of the first."""
    faded = np.flatnonzero(alike < MIN_LIKENESS * alike[0])
    return max(1, int(faded[0]) if len(faded) else len(alike))


def likeness(spectra: np.ndarray, band: Band, path: np.ndarray) -> np.ndarray:
    """Return the share of the speckle that spectra (n, R, C) 1, 2, ... apart have in common along a path (n, 2), (at most `MAX_REACH`,)."""
    weight = np.where(band.counts > 0.0, band.counts / np.maximum(band.signal + band.floor, 1e-300), 0.0)
    count = len(spectra)
    chosen = np.unique(np.linspace(0, count - 1, PAIRS).astype(int))

    def common(rows: slice) -> np.ndarray:
        moved = move_back(spectra[:, rows], band.part(rows), path)
        weighted = moved * weight[rows].astype(np.float32)
        pairs = [(chosen[chosen + step < count], step) for step in range(1, min(MAX_REACH + 1, count))]
        return np.array([np.vecdot(weighted[one], moved[one + step]).real.sum(1).mean() for one, step in pairs], np.float64)

    return sum_over_rows(common, spectra) / (weight * band.signal).sum()


def phase_walk(places: np.ndarray, fading: float, band: Band) -> np.ndarray:
    """Return the variance of positions (n, 2) by the phases of the illumination on the object, which change while the likeness falls.

    The likeness falls like exp(-x^2). The object has as many cells as it has coefficients. On its way, the field g of each changes by dg,
    and its phase by Im(g* dg). The mean slope of these phases across the object, summed along the path, has the variance
    (sqrt(pi) x erf(x) + exp(-x^2) - 1) / 2 over the cells and their mean square distance.

    Args:
        fading: square of x from frame to frame.
    """
    x = _ways(places, fading)
    phase = 0.5 * (np.pi**0.5 * x * erf(x) + np.exp(-(x**2)) - 1.0)
    return band.noise_gain * phase * band.inverse_spread.diagonal() / (4.0 * np.pi**2 * band.cells)


def _ways(places: np.ndarray, fading: float) -> np.ndarray:
    """Return the ways x along positions (n, 2), (n, 1), whose mean square from one to the next is the fading."""
    ways = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return fading**0.5 * np.concatenate([[0.0], np.cumsum(ways)])[:, None] / max(float(ways.mean()), 1e-9)


def _walk_by_change(places: np.ndarray, alike: np.ndarray, band: Band) -> np.ndarray:
    """Return the variance of positions (n, 2) by the change of the illumination on the object.

    Besides `phase_walk`, each way of the likeness c = `MIN_LIKENESS` replaces the pattern by another one. The Cramer-Rao
    bound of the displacement of two patterns whose coefficients are independent has the variance (1 - c^2) / c^2 over the sum of the
    squares of the angular frequencies, of those above the noise.
    """
    faded = np.flatnonzero(alike < MIN_LIKENESS * alike[0])
    fading = _fading(alike[: faded[0] + 1] if len(faded) else alike)
    clear = band.counts * (band.signal / np.maximum(band.signal + band.floor, 1e-300)) ** 2
    information = np.array([(clear * (2.0 * np.pi * turn) ** 2).sum() for turn in (band.rows[:, None], band.columns)])
    replaced = _ways(places, fading) / np.log(1.0 / MIN_LIKENESS) ** 0.5 * (1.0 / MIN_LIKENESS**2 - 1.0) / information
    return phase_walk(places, fading, band) + band.noise_gain * replaced


def _interpolate(at: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate linearly, and continue linearly beyond the ends."""
    return interp1d(known, values, fill_value="extrapolate")(at)
