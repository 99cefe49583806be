"""Normal equations of the corrections of several paths: score and Fisher information of the likelihood in `joint.py`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array

from invert.tracking.band import Band
from invert.tracking.components import Components
from invert.tracking.parts import on_all_cores

WINDOW = 32
"""Number of frames that are compared with one another. Windows overlap by half; up to twice as many frames are one window."""

PART = 256
"""Number of frequencies whose matrices are inverted at a time."""

MIN_POSITIONS = 4
ERROR_FRAMES = 48
"""Number of frames, evenly spaced, in which errors are computed, besides the first ones; between them, they are interpolated."""


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of the corrections of n paths.

    Attributes:
        turns: angular frequencies in radians per pixel, (K, 2).
        weights: independent coefficients that each frequency stands for, (K,).
        values: spectra, (K, frames).
        powers, noise: power of each object, (n, K), and of all else, (K,).
        fading: fading of each object, (n,).
        informations: Fisher information of the positions in each window, (L, n, 2, L, n, 2) each, per squared pixel.
        length: distance, in frames, of the positions that are estimated.
    """

    turns: np.ndarray
    weights: np.ndarray
    values: np.ndarray
    powers: np.ndarray
    noise: np.ndarray
    fading: np.ndarray
    informations: tuple[np.ndarray, ...] = ()
    length: int = 1

    @classmethod
    def of(cls, spectra: np.ndarray, band: Band, components: Components, places: np.ndarray) -> NormalEquations:
        """Return the equations from the frequencies at some places (K, 2) of a band, without information."""
        row, column = places.T
        share = float((band.counts > 0.0).sum()) / len(places)
        return cls(
            2.0 * np.pi * np.stack([band.rows[row], band.columns[column]], 1),
            0.5 * share * band.counts[row, column],
            np.ascontiguousarray(spectra[:, row, column].T),
            components.powers[:, row, column].astype(np.float32),
            components.noise[row, column].astype(np.float32),
            components.fading,
        )

    def add_information(self, paths: np.ndarray) -> NormalEquations:
        """Return the equations with the information near some paths (n, frames, 2)."""
        return replace(self, informations=tuple(self.information(paths, window) for window in self.windows()))

    @property
    def frames(self) -> int:
        return self.values.shape[1]

    @property
    def positions(self) -> int:
        """Number of positions that are estimated: from the first frame on, the last of them in the last frame or after it."""
        return (self.frames - 2) // self.length + 2

    def windows(self) -> list[slice]:
        """Return windows of frames; of several, which overlap by about half, each counts half."""
        if self.frames <= 2 * WINDOW:
            return [slice(0, self.frames)]
        firsts = np.linspace(0, self.frames - WINDOW, round(2 * self.frames / WINDOW) - 1).astype(int)
        return [slice(int(first), int(first) + WINDOW) for first in firsts]

    def lengths(self) -> list[int]:
        """Return the possible distances of positions, in frames: 1, and 2, 4 and more with at least `MIN_POSITIONS`."""
        most = max(1, (self.frames - 1) // (MIN_POSITIONS - 1))
        return [2**power for power in range(most.bit_length())]

    def errors_between_neighbours(self) -> np.ndarray:
        """Return the standard error in pixels of each object's positions between known neighbours, the median over its path and the larger
        of both axes, (n,)."""
        own = self._matrix[0].reshape(-1, len(self.powers), 2)
        return np.median(own[1:], 0).min(1).clip(1e-30) ** -0.5

    def solve(self, paths: np.ndarray) -> np.ndarray:
        """Return the corrections (n, frames, 2) of paths in pixels: the score over the information."""
        hats, count = self._hats, len(self.powers)
        right = (hats.T @ self.score(paths).reshape(self.frames, -1)).ravel()
        found = cho_solve_banded((self._factor, True), right).reshape(-1, 2 * count)
        return np.moveaxis((hats @ found).reshape(self.frames, count, 2), 0, 1)

    def errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the variances in squared pixels of the positions from the first, (n, frames, 2), and of second differences, (n, 2)."""
        factor, size, hats = self._factor, 2 * len(self.powers), self._hats
        early = 2 ** np.arange(int(np.log2(self.frames - 1)) + 1)
        chosen = np.unique(np.concatenate([[0], early, np.linspace(0, self.frames - 1, ERROR_FRAMES).astype(int)]))
        variance, bends = np.zeros((len(chosen), size)), np.zeros((len(chosen), size))
        for index, frame in enumerate(chosen):
            place = np.zeros((2, self.positions))
            place[0] = hats[[frame]].toarray()[0]
            middle = min(max(frame // self.length, 1), self.positions - 2)
            place[1, middle - 1 : middle + 2] = 1.0, -2.0, 1.0
            unit = np.einsum("kp,ab->pakb", place, np.eye(size)).reshape(self.positions * size, -1)
            found = (unit * cho_solve_banded((factor, True), unit)).sum(0)
            variance[index], bends[index] = found[:size], found[size:]
        variance[0] = 0.0
        every = np.stack([np.interp(np.arange(self.frames), chosen, one) for one in variance.T], 1)
        return np.moveaxis(every.reshape(self.frames, -1, 2), 0, 1), bends.mean(0).reshape(-1, 2) / self.length**3

    def score(self, paths: np.ndarray) -> np.ndarray:
        """Return the slope of the log-likelihood with the position in each frame, (frames, n, 2) per pixel."""
        windows, total = self.windows(), np.zeros((self.frames, len(self.powers), 2))
        for window in windows:
            total[window] += self._sum(paths, window, _score) / min(len(windows), 2)
        return total

    def information(self, paths: np.ndarray, window: slice) -> np.ndarray:
        """Return the Fisher information of the positions in a window, (L, n, 2, L, n, 2) per squared pixel.

        A displacement of a whole path changes nothing, because its pattern is unknown; rounding must not change that.
        """
        found = self._sum(paths, window, _information)
        found -= found.mean(0)
        return found - found.mean(3, keepdims=True)

    @cached_property
    def _hats(self) -> csr_array:
        """Contributions of positions to frames, (frames, positions): straight lines between them."""
        at = np.arange(self.frames)
        before, part = at // self.length, at % self.length / self.length
        places = np.concatenate([before, np.minimum(before + 1, self.positions - 1)])
        return csr_array(
            (np.concatenate([1.0 - part, part]), (np.concatenate([at, at]), places)), (self.frames, self.positions)
        )

    @cached_property
    def _matrix(self) -> np.ndarray:
        """Information of the positions as a lower band matrix, (bands, positions n 2)."""
        size, windows, hats = 2 * len(self.powers), self.windows(), self._hats
        longest = min(self.positions, (windows[0].stop - 2) // self.length + 3)
        bands = np.zeros((size * longest, size * self.positions))
        for window, information in zip(windows, self.informations, strict=True):
            first, last = window.start // self.length, min(self.positions, (window.stop - 2) // self.length + 2)
            own = hats[window][:, first:last].toarray()
            flat = np.einsum("ta,tisj,sb->aibj", own, information.reshape(len(own), size, len(own), size), own, optimize=True)
            flat, start = flat.reshape((last - first) * size, -1), first * size
            for below in range(len(flat)):
                bands[below, start : start + len(flat) - below] += np.diagonal(flat, -below) / min(len(windows), 2)
        return bands

    @cached_property
    def _factor(self) -> np.ndarray:
        """Cholesky factor of the matrix with the first position fixed."""
        bands = self._matrix.copy()
        bands[0] += 1e-8 * bands[0].mean()
        bands[0, : 2 * len(self.powers)] += 1e3 * bands[0].max()
        return cholesky_banded(bands, lower=True)

    def _sum(self, paths: np.ndarray, window: slice, task: Callable[..., np.ndarray]) -> np.ndarray:
        """Return the sum over all frequencies of the result of a task in a window."""
        places, numbers = paths[:, window], np.arange(window.start, window.stop)
        alike = np.exp(-self.fading[:, None, None] * (numbers[:, None] - numbers) ** 2.0).astype(np.float32)

        def part(first: int) -> np.ndarray:
            some = slice(first, first + PART)
            turned = [np.exp(-1j * self.turns[some] @ place.T).astype(np.complex64) for place in places]
            patterns = [
                power[some, None, None] * share * one[:, :, None] * one.conj()[:, None]
                for power, share, one in zip(self.powers, alike, turned, strict=True)
            ]
            covariance = np.sum(patterns, 0)
            diagonal = np.arange(len(numbers))
            covariance[:, diagonal, diagonal] += self.noise[some, None]
            return task(self, some, window, patterns, np.linalg.inv(covariance))

        return np.sum(on_all_cores(part, range(0, len(self.weights), PART)), 0)


def _score(
    equations: NormalEquations, some: slice, window: slice, patterns: list[np.ndarray], inverse: np.ndarray
) -> np.ndarray:
    """Return the slope of the log-likelihood with the positions, (L, n, 2), from some frequencies."""
    likely = (inverse @ equations.values[some, window, None])[..., 0]
    weight = (equations.weights[some, None] * equations.turns[some]).T
    slopes = [
        weight @ (np.einsum("ktu,kut->kt", one, inverse) - (one @ likely[..., None])[..., 0] * likely.conj()).imag
        for one in patterns
    ]
    return -2.0 * np.moveaxis(np.stack(slopes), 2, 0)


def _information(
    equations: NormalEquations, some: slice, _: slice, patterns: list[np.ndarray], inverse: np.ndarray
) -> np.ndarray:
    """Return the Fisher information of the positions, (L, n, 2, L, n, 2), from some frequencies."""
    turns, side, count = equations.turns[some], inverse.shape[1], len(patterns)
    found = np.empty((side, count, 2, side, count, 2))
    products = [one @ inverse for one in patterns]
    for one in range(count):
        for other in range(one, count):
            both = products[one] @ patterns[other] * np.swapaxes(inverse, 1, 2)
            both -= products[one] * np.swapaxes(products[other], 1, 2)
            flat = both.real.reshape(len(turns), -1)
            for axis, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
                weight = 2.0 * equations.weights[some] * turns[:, axis] * turns[:, across]
                block = (weight @ flat).reshape(side, side)
                found[:, one, axis, :, other, across] = block
                found[:, other, across, :, one, axis] = block.T
    return found
