"""Registration of groups of frames to the sums of those around them, and the standard errors of their places."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded
from scipy.special import erf

from invert.tracking.band import Band
from invert.tracking.parts import sum_over_rows
from invert.tracking.shifts import Weight, derivatives, moments, move_back, weight_of, window_slopes

MAX_REACH = 16
"""Number of groups on each side, at most, to which one is registered."""

MIN_LIKENESS = 0.6
"""Share of the common speckle of neighbours that groups must still have in common."""

PAIRS = 48
"""Pairs of groups from which a likeness is measured."""

PATTERNS = 8
"""Number of patterns from which the noise of their bright spots is measured."""

WINDOW_ERROR = 0.35
"""Relative error of what the window draws paths by, where grains are large in a frame (docs/tracking.md, "Limits")."""

ROUNDS = 8
CONVERGED_GRAINS = 0.01
"""Largest change of a displacement between neighbours, in radii of a grain, at which a registration ends."""


class Registration(NamedTuple):
    """Groups of frames registered to those around them.

    Attributes:
        places: positions (n, 2).
        error: their standard errors, (n, 2).
        reach: largest distance of the pairs.
        of_pair: variance of the displacement of a pair of usual light, (2,).
        significance: median height of the cross-correlations, in standard deviations of noise.
    """

    places: np.ndarray
    error: np.ndarray
    reach: int
    of_pair: np.ndarray
    significance: float


def register(sums: np.ndarray, band: Band, places: np.ndarray, light: np.ndarray) -> Registration:
    """Register groups of frames (n, R, C) near approximate positions (n, 2).

    All pairs within the reach are registered together by Gauss-Newton steps on the sum of their cross-correlations. The
    curvature of a pair is in proportion to the light of both, and so is its noise, which is taken for that of photons. What the noise of a
    pair moves its two members by then cancels beyond them; own curvatures would add it up twice along the path.

    Args:
        light: amplitude of the speckle of each group over that of the band, (n,).
    """
    for _ in range(ROUNDS):
        alike = likeness(sums, band, places, light)
        reach = reach_of(alike)
        others = _around(light, reach)
        stiffness = light * others
        low, high = _window(len(sums), reach)
        usual = max(1, int(np.median(high - low - 1)))
        weight = weight_of(band, float(np.clip(alike[0], 0.05, 1.0)), usual)
        height, slope, curvature = derivatives(_pull_of_surroundings(sums, band, places, reach, weight))
        inverse = np.linalg.inv(-curvature.sum(0) / stiffness.sum())
        correction = solve_pairs(slope @ inverse, reach, light)
        places = places + correction
        if np.abs(np.diff(correction, axis=0)).max() < CONVERGED_GRAINS * band.grain_pixels:
            break
    of_pair = np.diag(inverse @ weight.slope_variance @ inverse) / usual
    excess = 1.0 + _excess_of_bright_spots(sums, band, places, reach, weight)
    of_pair = of_pair * excess
    slopes = weight.slope_variances(light, others, _around(light**2, reach))
    variance = np.einsum("ab,nbc,ca->na", inverse, slopes, inverse) / stiffness[:, None] ** 2 * excess
    # Over distances beyond the reach, errors add up like resistances of a chain in which each member is joined to its neighbours.
    resistances = np.concatenate([[0.0], np.cumsum(1.0 / (light[1:] * light[:-1]))])
    walked = resistances[:, None] / np.sum(np.arange(1.0, reach + 1.0) ** 2) * of_pair
    walked = walked + _walk_by_change(places, alike, band)
    # Where grains are large in a frame, this pull is known to first order only, and would grow with each round.
    drawn = drawn_by_windows(places, band, weight, alike[:reach], light, inverse)
    error = np.sqrt(variance + walked + (WINDOW_ERROR * drawn) ** 2)
    significance = float(np.median(height)) / weight.deviation
    return Registration(places - drawn, error, reach, of_pair, significance)


def _pull_of_surroundings(sums: np.ndarray, band: Band, places: np.ndarray, reach: int, weight: Weight) -> np.ndarray:
    """Return the moments (n, 3, 3) at zero shift of the cross-correlations of groups, moved back to their places, with the sums of all
    others within the reach."""
    count = len(sums)
    low, high = _window(count, reach)

    def pull(rows: slice) -> np.ndarray:
        part, values = band.part(rows), weight.part(rows).values
        moved = move_back(sums[:, rows], part, places)
        total = np.zeros((count + 1, *moved.shape[1:]), moved.dtype)
        np.cumsum(moved, 0, out=total[1:])
        around = total[high] - total[low] - moved
        return moments(around.conj() * moved * values.astype(np.float32), part, np.zeros((count, 2)))

    return sum_over_rows(pull, sums)


def _window(count: int, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first group within the reach of each, and the one after the last, (count,) each."""
    low, high = (np.clip(np.arange(count) + side, 0, count) for side in (-reach, reach + 1))
    return low, high


def _around(light: np.ndarray, reach: int) -> np.ndarray:
    """Return the sum of the light (n,) of all others within the reach of each, (n,)."""
    total = np.concatenate([[0.0], np.cumsum(light)])
    low, high = _window(len(light), reach)
    return total[high] - total[low] - light


def _excess_of_bright_spots(sums: np.ndarray, band: Band, places: np.ndarray, reach: int, weight: Weight) -> np.ndarray:
    """Return what is added to the variance of a registration, over that of noise which is the same everywhere, (2,).

    The noise of photons goes with the light, and the slopes of the pattern, which tell its place, are largest where it is bright. All noise
    is taken for that of photons.
    """
    count, each = len(sums), weight.values / np.maximum(band.counts, 1.0)
    turns = np.broadcast_to(band.rows[:, None], band.signal.shape), np.broadcast_to(band.columns, band.signal.shape)
    found = []
    for middle in np.unique(np.linspace(0, count - 1, PATTERNS).astype(int)):
        first, last = max(0, middle - reach), min(count, middle + reach + 1)
        signal, floor = (last - first) * band.signal, np.broadcast_to(band.floor, band.signal.shape)
        total = move_back(sums[first:last], band, places[first:last] - places[middle]).sum(0)
        light = band.image(total * signal / (signal + floor))  # of all; the rest is noise of the sum
        squares = np.array([(band.image(1j * turn * total * each) ** 2).ravel() for turn in turns])
        known = np.array([(band.counts * (each * turn) ** 2 * signal).sum() for turn in turns])
        part = known / (known + np.array([(band.counts * (each * turn) ** 2 * floor).sum() for turn in turns]))
        found.append(band.contrast * part * (squares @ light.ravel()) / np.maximum(light.std() * squares.sum(1), 1e-300))
    return np.maximum(np.mean(found, 0), 0.0)


def drawn_by_windows(
    places: np.ndarray, band: Band, weight: Weight, alike: np.ndarray, light: np.ndarray, inverse: np.ndarray
) -> np.ndarray:
    """Return by how much the windows of the frames draw places (n, 2) that are registered in pairs, (n, 2), to first order.

    Args:
        alike: share of the speckle in common of groups 1, 2, ... apart, up to the largest distance of the pairs.
        light: amplitude of the speckle of each group, (n,).
        inverse: inverse of the curvature of a pair of usual light, (2, 2).
    """
    pull = weight.full / weight.frames * _pull_of_windows(places, band, alike, light) @ weight.tilt.T
    return solve_pairs(pull @ inverse, len(alike), light)


def _pull_of_windows(places: np.ndarray, band: Band, alike: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Return by how much the logarithms of the overlaps of windows fall at the distances of places (n, 2), summed over the neighbours of
    each with likeness and light (n,) as weights, (n, 2): the windows stay where they are, and draw the places towards each other."""
    pull = np.zeros_like(places)
    for step, likeness_ in enumerate(alike, start=1):
        shared = likeness_ * light[step:] * light[:-step]
        slopes = shared[:, None] * window_slopes(places[step:] - places[:-step], band)
        pull[step:] += slopes
        pull[:-step] -= slopes
    return pull


def solve_pairs(slopes: np.ndarray, reach: int, light: np.ndarray) -> np.ndarray:
    """Return corrections (n, 2) of positions, whose differences over all pairs within the reach, times the light (n,) of both, add up to
    the slopes (n, 2); 0 for the first."""
    count = len(slopes)
    bands = np.zeros((reach + 1, count))
    for step in range(1, min(reach + 1, count)):
        shared = light[step:] * light[:-step]
        bands[step, : count - step] = -shared
        bands[0, : count - step] += shared
        bands[0, step:] += shared
    bands[0] += 1e-6  # what no pair joins stays; the slopes add up to zero, and the mean with them
    found = solveh_banded(bands, slopes, lower=True)
    return found - found[0]


def reach_of(alike: np.ndarray) -> int:
    """Return the number of distances, at least 1, over which the likeness stays above `MIN_LIKENESS` of the first."""
    faded = np.flatnonzero(alike < MIN_LIKENESS * alike[0])
    return max(1, int(faded[0]) if len(faded) else len(alike))


def likeness(spectra: np.ndarray, band: Band, path: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Return the share of the speckle that spectra (n, R, C) 1, 2, ... apart have in common along a path (n, 2), (at most `MAX_REACH`,).

    It is divided by the products of their light (n,).
    """
    count = len(spectra)
    chosen = np.unique(np.linspace(0, count - 1, PAIRS).astype(int))
    pairs = [(chosen[chosen + step < count], step) for step in range(1, min(MAX_REACH + 1, count))]
    found = likeness_of_pairs(pairs, spectra, band, path)
    return np.array(
        [alike.sum() / (light[one] * light[one + step]).sum() for alike, (one, step) in zip(found, pairs, strict=True)]
    )


def likeness_of_pairs(
    pairs: list[tuple[np.ndarray, int]], spectra: np.ndarray, band: Band, path: np.ndarray
) -> list[np.ndarray]:
    """Return the share of the speckle that spectra (n, R, C) have in common with those some steps later, for first ones of each step."""
    weight = band.whitening

    def common(rows: slice) -> np.ndarray:
        moved = move_back(spectra[:, rows], band.part(rows), path)
        weighted = moved * weight[rows].astype(np.float32)
        return np.concatenate([np.vecdot(weighted[one], moved[one + step]).real.sum(1) for one, step in pairs]).astype(
            np.float64
        )

    found = sum_over_rows(common, spectra) / (weight * band.signal).sum()
    return np.split(found, np.cumsum([len(one) for one, _ in pairs])[:-1])


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
    fading = fading_of(alike[: faded[0] + 1] if len(faded) else alike)
    clear = band.counts * (band.signal / np.maximum(band.signal + band.floor, 1e-300)) ** 2
    information = np.array([(clear * (2.0 * np.pi * turn) ** 2).sum() for turn in (band.rows[:, None], band.columns)])
    replaced = _ways(places, fading) / np.log(1.0 / MIN_LIKENESS) ** 0.5 * (1.0 / MIN_LIKENESS**2 - 1.0) / information
    return phase_walk(places, fading, band) + band.noise_gain * replaced


def fading_of(alike: np.ndarray) -> float:
    """Return the fading from the first and the last of the likenesses exp(-fading k^2) of frames k = 1, 2, ... apart."""
    if len(alike) < 2 or alike[0] <= 0.0:
        return 0.0
    return float(np.log(1.0 / np.clip(alike[-1] / alike[0], 1e-3, 1.0)) / (len(alike) ** 2 - 1.0))
