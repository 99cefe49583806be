"""Maxima of the cross-correlations of frames one or several distances apart.

Motion moves the maximum of an object in proportion to the distance of the frames. The side maxima of its speckle keep their place beside
it, and the interference of two objects changes from distance to distance: neither lies in proportion at all distances.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.fft import fftfreq, irfft2, next_fast_len
from scipy.ndimage import maximum_filter

from invert.tracking.band import Band
from invert.tracking.shifts import MIN_SIGNIFICANCE, Weight, fold, move_back, refine

GRID_PER_PERIOD = 1.5
"""Grid points of a cross-correlation per period of twice its highest frequency."""

MIN_RELATIVE_HEIGHT = 0.02
"""Height of a maximum over that of the highest below which it is not another object: a seventh of its light."""

CANDIDATES = 16
"""Number of maxima at the largest distance of which the one that is highest at all distances is taken."""

MAX_SIDES = 3
"""Number of maxima that belong to those already found, after which the search ends."""


@dataclass(frozen=True)
class Crossed:
    """Mean cross-spectra of frames at some distances.

    Attributes:
        cross: mean cross-spectra of frames at n distances, (n, R, C).
        scales: these distances over the first, the largest, (n,).
        own: mean power of the same frames without the noise floor, (R, C).
        pairs: number of pairs of frames at each distance.
    """

    cross: np.ndarray
    scales: np.ndarray
    own: np.ndarray
    pairs: int


def grid_of(band: Band) -> tuple[int, int]:
    """Return the rows and columns of the coarse grid of a cross-correlation."""
    rows, columns = (
        next_fast_len(int(GRID_PER_PERIOD * (2 * int(np.round(np.abs(part).max() * side)) + 1)), real=True)
        for part, side in zip((band.rows, band.columns), band.shape, strict=True)
    )
    return rows, columns


def correlate(cross: np.ndarray, band: Band, weight: Weight) -> tuple[np.ndarray, np.ndarray]:
    """Return the weighted cross-correlation of one cross-spectrum (R, C) on a coarse grid, zero shift first, and the pitch of that grid in
    pixels along rows and columns."""
    shape = grid_of(band)
    spectrum = np.zeros((shape[0], shape[1] // 2 + 1), np.complex64)
    place = np.round(band.rows * band.shape[0]).astype(int) % shape[0]
    spectrum[place, : len(band.columns)] = cross * (weight.values / np.maximum(band.counts, 1.0))
    found = irfft2(spectrum, s=shape) * np.float32(shape[0] * shape[1])
    return found, np.array(band.shape) / np.array(shape)


def highest(cross: np.ndarray, band: Band, weight: Weight) -> tuple[np.ndarray, float]:
    """Return the displacement (2,) of the maximum of the cross-correlation of one cross-spectrum (R, C), and its height."""
    found, pitch = correlate(cross, band, weight)
    place, heights = refine(cross[None], band, weight, _coarse(found, pitch, band), np.ones(1))
    return place, float(heights[0])


def maxima(
    crossed: Crossed, band: Band, weight: Weight, most: int, min_height: float = MIN_RELATIVE_HEIGHT
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the displacements of objects over the largest distance, (k, 2) in pixels, the mean heights of their maxima, and their
    significance, (k,) each; those above `MIN_SIGNIFICANCE` and a height over that of the highest, at most a number.

    Each displacement found is subtracted, with all that belongs to it, before the next. What lies so close to another one that both would
    interfere is not another one.
    """
    full = max(float((weight.values * crossed.own).sum()), 1e-300)
    deviation = weight.deviation / (crossed.pairs * len(crossed.cross)) ** 0.5
    places, heights, significance = np.zeros((0, 2)), [], []
    left, sides, largest, mean_scale = crossed.cross.copy(), 0, 0.0, float(crossed.scales.mean())
    while len(heights) < most and sides < MAX_SIDES:
        exact, each, noise = _highest_in_proportion(left, crossed.scales, band, weight)
        # Bright speckle that outlives a pair of frames makes the noise of a mean larger than that of independent pairs.
        deviation = max(deviation, noise)
        height = float(each.mean())
        largest = max(height, largest)
        if height < max(MIN_SIGNIFICANCE * deviation, min_height * largest):
            break
        if all(band.are_apart(mean_scale * (exact - other)) for other in places):
            places = np.concatenate([places, exact[None]])
            heights.append(height)
            significance.append(height / deviation)
        else:
            sides += 1
        part = np.clip(each / full, 0.0, 1.0).astype(np.float32)[:, None, None] * crossed.own
        left -= move_back(part.astype(np.complex64), band, -crossed.scales[:, None] * exact)
    return places, np.array(heights), np.array(significance)


def _highest_in_proportion(
    cross: np.ndarray, scales: np.ndarray, band: Band, weight: Weight
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the displacement (2,) whose multiples by scales (n,) have the highest mean in cross-correlations of spectra (n, R, C), its
    height in each, and the standard deviation of the noise of their mean."""
    grids = [correlate(one, band, weight) for one in cross]
    first, pitch = grids[0]

    def at(rows: np.ndarray, columns: np.ndarray, beside: tuple[int, int] = (0, 0)) -> np.ndarray:
        """Return the heights (n, ...) at, or beside, the multiples of places on the grid, whose rows and columns broadcast."""
        return np.stack(
            [
                one[np.round(scale * rows).astype(int) + beside[0], np.round(scale * columns).astype(int) + beside[1]]
                for (one, _), scale in zip(grids, scales, strict=True)
            ]
        )

    everywhere = np.ix_(*(fftfreq(side, 1.0 / side)[::4] for side in first.shape))
    noise = float(np.median(np.abs(at(*everywhere).mean(0))) / 0.6745)
    if len(cross) == 1:
        start = _coarse(first, pitch, band)
    else:
        tops = np.argwhere(first == maximum_filter(first, 3, mode="wrap"))
        tops = tops[np.argsort(-first[tuple(tops.T)])][:CANDIDATES]
        moves = fold(tops * pitch, band)
        near = np.max([at(*(moves / pitch).T, beside) for beside in product((-1, 0, 1), repeat=2)], 0)
        start = moves[np.argmax(near.mean(0))]
    return *refine(cross, band, weight, start, scales), noise


def _coarse(found: np.ndarray, pitch: np.ndarray, band: Band) -> np.ndarray:
    """Return the displacement (2,) of the maximum of a cross-correlation on a grid of a pitch in pixels."""
    return fold(np.array(np.unravel_index(int(found.argmax()), found.shape)) * pitch, band)
