"""Most likely path of a single object in frames so dim that no pair of them shows its motion.

A block of frames long enough to show a motion misses a turn within it. Here, the motion may change at each frame, at the cost of
likelihood. The displacement of each step lies on a grid; the sequence with the highest sum of evidence and of the logarithms of the
probabilities of its changes is found by dynamic programming (Viterbi, doi:10.1109/TIT.1967.1054010).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.fft import fftfreq

from invert.tracking.band import Band
from invert.tracking.maxima import correlate, grid_of
from invert.tracking.shares import Shares, mean_overlap
from invert.tracking.shifts import MIN_SIGNIFICANCE, fold, weight_of
from invert.tracking.start import Start, replace_path

LAGS = (1, 2, 3, 4)
"""Distances of the frames whose cross-correlations are evidence. A displacement that changes within is seen by the shorter ones."""

OTHER_LAGS = (5, 6, 7, 8)
"""Distances of the frames that decide between two paths, because they served neither."""

MIN_GAIN_SIGMA = 3.0
"""Standard deviations by which such frames must have more in common along the most likely path than along another."""

SHARE_TO_SEE = 0.5
"""Share of the speckle that a pair of frames should show if the motion of single frames is to be seen."""

FINENESS = (3, 2, 1)
"""Points of the grid of steps per point of a cross-correlation along each axis, the first that is possible."""

MAX_POINTERS = 2**27
"""Largest number of grid points of all steps together, a byte each."""

CHANGE_CELLS = 1.0
"""Standard deviation of the change of the displacement from step to step along each axis, in points of the grid."""

TURN = 0.02
"""Probability that the object goes on with any other displacement, as if it turned."""


def refine_dim_path(spectra: np.ndarray, band: Band, start: Start) -> Start:
    """Return a single object with the most likely path if pairs of frames are dim, and if frames have more in common along it."""
    weight = weight_of(band, 0.0)
    shows_pairs = SHARE_TO_SEE * weight.full > MIN_SIGNIFICANCE * weight.deviation
    if shows_pairs or len(spectra) <= OTHER_LAGS[-1] or (path := most_likely_path(spectra, band)) is None:
        return start
    (found, error), (before, its_error) = (_in_common(spectra, band, one) for one in (path, start.path))
    is_better = found - before > MIN_GAIN_SIGMA * np.hypot(error, its_error)
    return replace_path(start, spectra, band, path) if is_better else start


def _in_common(spectra: np.ndarray, band: Band, path: np.ndarray) -> tuple[float, float]:
    """Return the share of the speckle that frames `OTHER_LAGS` apart have in common along a path, and its standard error by noise and, as
    the speckle of all these frames may be the same, by the cells of its object."""
    shares = Shares(spectra, band)
    found = [shares.along(path, lag) for lag in OTHER_LAGS]
    noise = [shares.noise(len(spectra) - lag) / mean_overlap(path[lag:] - path[:-lag], band) for lag in OTHER_LAGS]
    return float(np.mean(found)), float((np.mean(np.square(noise)) / len(noise) + 1.0 / band.cells) ** 0.5)


def most_likely_path(spectra: np.ndarray, band: Band) -> np.ndarray | None:
    """Return the most likely path (frames, 2) of a single object, in pixels from its first position, from spectra (frames, R, C); None if
    the grid of all displacements exceeds the memory, or if no displacement lasts for `LAGS[-1]` steps.

    A displacement that lasts for fewer steps may be noise where frames have nothing in common; there, the path is interpolated from the
    steps before and after.
    """
    coarse, steps = grid_of(band), len(spectra) - 1
    fineness = next((one for one in FINENESS if steps * one**2 * coarse[0] * coarse[1] <= MAX_POINTERS), None)
    if fineness is None or steps < LAGS[-1]:
        return None
    places, turns = _most_likely_steps(_evidence(spectra, band, fineness), steps)
    lasts = np.repeat(np.diff(turns) >= LAGS[-1], np.diff(turns))
    if not lasts.any():
        return None
    moves, known = fold(places * np.array(band.shape) / coarse / fineness, band), np.flatnonzero(lasts)
    moves = np.stack([np.interp(np.arange(steps), known, moves[known, axis]) for axis in (0, 1)], 1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(moves, 0)])


def _most_likely_steps(evidence: Iterator[np.ndarray], steps: int) -> tuple[np.ndarray, list[int]]:
    """Return the places (steps, 2) on the grid of the evidence for each step, and the steps at which the object turns, 0 and `steps` with
    them."""
    total = next(evidence).copy()
    sides, turn = total.shape, np.log(TURN / total.size)
    near = np.exp(-0.5 * (np.arange(-1, 2) / CHANGE_CELLS) ** 2)
    change = np.log(near / near.sum() * (1.0 - TURN) ** 0.5).astype(np.float32)
    ways, before_turn = np.zeros((steps, *sides), np.int8), np.zeros(steps, int)
    for number, one in enumerate(evidence, 1):
        before_turn[number] = int(total.argmax())
        after_turn = total.ravel()[before_turn[number]] + turn
        total, ways[number] = _go_on(total, change)
        ways[number][total < after_turn] = -1
        np.maximum(total, after_turn, out=total)
        total += one
    places, turns = np.zeros((steps, 2), int), [0, steps]
    places[-1] = np.unravel_index(int(total.argmax()), sides)
    for number in range(steps - 1, 0, -1):
        way = ways[number][tuple(places[number])]
        if way < 0:
            turns.insert(1, number)
            places[number - 1] = np.unravel_index(before_turn[number], sides)
        else:
            places[number - 1] = (places[number] + (way // 3 - 1, way % 3 - 1)) % sides
    return places, turns


def _go_on(total: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the highest sum by which each displacement (rows, columns) is reached from those beside it, and the way: 3 times that along
    rows plus that along columns, 0 from the one before, 1 from itself, 2 from the one after."""
    total, rows = _step_along(total, change, 0)
    total, columns = _step_along(total, change, 1)
    before, after = np.roll(rows, 1, 1), np.roll(rows, -1, 1)
    np.copyto(rows, before, where=columns == 0)
    np.copyto(rows, after, where=columns == 2)
    return total, 3 * rows + columns


def _step_along(total: np.ndarray, change: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    before, same, after = (np.roll(total, 1 - way, axis) + change[way] for way in range(3))
    way = np.multiply(after > before, 2, dtype=np.int8)
    np.maximum(before, after, out=before)
    np.copyto(way, 1, where=same >= before)
    return np.maximum(before, same), way


def _evidence(spectra: np.ndarray, band: Band, fineness: int) -> Iterator[np.ndarray]:
    """Yield the log-likelihood ratio of each displacement on a grid (rows, columns) for each step.

    A pair of frames some steps apart tells the mean of these steps, and adds its part to each.
    """
    weight = weight_of(band, 0.0)
    gain, shape = np.float32(weight.full / weight.deviation**2), grid_of(band)
    places = {lag: np.ix_(*(_places(side, fineness, lag) for side in shape)) for lag in LAGS}
    pairs: dict[tuple[int, int], np.ndarray] = {}
    for step in range(len(spectra) - 1):
        found = np.zeros((fineness * shape[0], fineness * shape[1]), np.float32)
        for lag in LAGS:
            around = np.zeros((shape[0] + 1, shape[1] + 1), np.float32)
            for first in range(max(0, step - lag + 1), min(step, len(spectra) - 1 - lag) + 1):
                if (first, lag) not in pairs:
                    cross = spectra[first].conj() * spectra[first + lag]
                    pairs[first, lag] = correlate(cross, band, weight)[0] * (gain / lag)
                around[:-1, :-1] += pairs[first, lag]
            found += around[places[lag]]
        pairs = {key: one for key, one in pairs.items() if sum(key) > step + 1}
        yield found


def _places(side: int, fineness: int, lag: int) -> np.ndarray:
    """Return the points of a cross-correlation of a side nearest to `lag` times each displacement of a finer grid; the side itself for
    displacements beyond it, of frames that see nothing in common."""
    moves = lag * fftfreq(fineness * side, 1.0 / (fineness * side)) / fineness
    return np.where(np.abs(moves) < side, np.round(moves).astype(int) % side, side)
