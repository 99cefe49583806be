"""Likelihood of patterns that fade.

The patterns are Gaussian random fields that travel along paths p and fade as the illumination on the objects changes. The spectra of frames
t and s at a frequency f have the covariance

    C_ts = sum over objects  A_ts exp(-2 pi i f (p_t - p_s)), plus N if t = s,    A_ts = sum over l of S_l exp(-((t - s) / l)^2),

with some lengths l in frames. The powers S_l >= 0 of each pattern and N are constants in cells of neighbouring frequencies, at the maximum
of the likelihood: each is multiplied by the ratio of both terms of its slope, x* dC x over tr(C^-1 dC) with x = C^-1 y for spectra y, until
nothing is gained (as in C. Fevotte, N. Bertin, J.-L. Durrieu, Neural Computation 21, 793, 2009). Slope and information are those of
P. Stoica, R. Moses, Spectral Analysis of Signals, 2005, appendix B.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invert.tracking.band import Band
from invert.tracking.likelihood import frequencies_in_cells
from invert.tracking.parts import on_all_cores

LENGTHS = np.array([1.5, 4.0, 10.0, 25.0, 100.0])
"""Numbers of frames in which a part of a pattern fades."""

SOUGHT, FINE = 600, 2400
"""About the numbers of frequencies times that of windows by which paths are sought, and by which they are measured."""

CELL = 4
"""Side of a cell in frequencies that are used."""

WINDOW = 48
"""Largest number of frames that are compared with one another. Longer captures are cut into windows, at fewer frequencies each."""

PART, FOR_INFORMATION = 64, 4
"""Number of frequencies whose matrices are inverted at a time; one in so many of them gives the information."""

FLOOR = 1e-6
"""Least noise over the mean power."""


@dataclass(frozen=True)
class Powers:
    """Powers of patterns, (n, lengths, frequencies), and of the noise, (frequencies,)."""

    patterns: np.ndarray
    noise: np.ndarray


@dataclass(frozen=True)
class Step:
    """The likelihood of some paths and powers.

    Attributes:
        height: its logarithm, over that of noise alone.
        powers: powers at which it is higher.
        slope, information: its slope with velocities that are added to the paths, (n, 2), and their Fisher information, (2 n, 2 n).
    """

    height: float
    powers: Powers
    slope: np.ndarray
    information: np.ndarray


@dataclass(frozen=True)
class _Part:
    """Covariance of K frequencies in a window of frames.

    Attributes:
        turned: phases of each pattern, (K, frames).
        alike: likeness of the frames of a pattern that fades in each of the lengths, (lengths, frames, frames).
        patterns: covariance of each pattern, (K, frames, frames).
        inverse: inverse of the whole covariance, (K, frames, frames).
        likely: its product with the spectra, (K, frames).
        height: logarithm of the likelihood, (K,).
    """

    turned: list[np.ndarray]
    alike: np.ndarray
    patterns: list[np.ndarray]
    inverse: np.ndarray
    likely: np.ndarray
    height: np.ndarray

    def terms(self, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return both terms of the slope with the powers of a pattern of some phases, (lengths, K) each."""
        back = turned.conj()
        return _sum_products(self.likely * back, np.ones(1), self.alike), _sum_products(back, self.inverse, self.alike)


class FadingLikelihood:
    """Likelihood of patterns, from spectra (frames, R, C).

    Args:
        frequencies: about the number of frequencies times that of windows.
        used: whether each frame counts, bool (frames,).

    Attributes:
        cells: number of cells of frequencies.
    """

    def __init__(self, spectra: np.ndarray, band: Band, frequencies: int, used: np.ndarray) -> None:
        numbers = np.flatnonzero(used)
        self._windows = np.array_split(numbers, -(-len(numbers) // WINDOW))
        every = max(1.0, (band.counts > 0.0).sum() / (frequencies // len(self._windows)))
        down = round(every**0.5)
        rows, columns, self._starts = frequencies_in_cells(band, (down, max(1, round(every / down))), CELL)
        self.cells, self._sizes = len(self._starts), np.diff(self._starts, append=len(rows))
        self._turns = 2.0 * np.pi * np.stack([band.rows[rows], band.columns[columns]])
        counts = band.counts[rows, columns]
        # Two conjugate coefficients are one, the window correlates neighbours, and some stand for all.
        self._counts = 0.5 * counts / band.noise_gain * (band.counts.sum() / counts.sum())
        self._values = [spectra[window][:, rows, columns].T.astype(np.complex128) for window in self._windows]
        self._total = self._in_cells(sum((np.abs(one) ** 2).sum(1) for one in self._values) / len(numbers))
        self._none = -float((self._counts * len(numbers) * (np.log(self._total) + 1.0)).sum())

    def begin(self, patterns: int) -> Powers:
        """Return powers with which a fit begins: all the same."""
        shares = np.full((patterns, len(LENGTHS), 1), 0.5 / (patterns * len(LENGTHS)))
        return Powers(shares * self._total, 0.5 * self._total)

    def step(self, paths: Sequence[np.ndarray], powers: Powers, moves: bool = False) -> Step:
        """Return the likelihood of patterns along paths (frames, 2), and a step up. Slope and information are zero unless paths move."""
        above, below = np.zeros_like(powers.patterns), np.zeros_like(powers.patterns)
        noise_above, noise_below, height = np.zeros_like(powers.noise), np.zeros_like(powers.noise), 0.0
        slope, information = np.zeros((len(paths), 2)), np.zeros((2 * len(paths), 2 * len(paths)))

        def in_part(place: tuple[int, slice]) -> tuple:
            known = self._part(paths, powers, *place)
            noise = (np.abs(known.likely) ** 2).sum(1), np.einsum("ktt->k", known.inverse).real
            return (
                known.height,
                [known.terms(one) for one in known.turned],
                noise,
                self._derive(known, *place) if moves else None,
            )

        places = self._places()
        for (_, some), (its_height, terms, noise, derivatives) in zip(places, on_all_cores(in_part, places), strict=True):
            height += float((self._counts[some] * its_height).sum())
            for number, its in enumerate(terms):
                above[number, :, some] += its[0]
                below[number, :, some] += its[1]
            noise_above[some] += noise[0]
            noise_below[some] += noise[1]
            if derivatives:
                slope += derivatives[0]
                information += derivatives[1]
        noise = powers.noise * self._in_cells(noise_above) / self._in_cells(noise_below)
        higher = powers.patterns * self._in_cells(np.maximum(above, 0.0)) / np.maximum(self._in_cells(below), 1e-300)
        return Step(height - self._none, Powers(higher, np.maximum(noise, FLOOR * self._total)), slope, information)

    def _places(self) -> list[tuple[int, slice]]:
        """Return numbers of windows and parts of the frequencies."""
        firsts = range(0, len(self._counts), PART)
        return [(number, slice(first, first + PART)) for number in range(len(self._windows)) for first in firsts]

    def _phases(self, path: np.ndarray, number: int, some: slice) -> np.ndarray:
        """Return the phases of a path (frames, 2) in a window at some frequencies, (K, frames)."""
        return np.exp(-1j * (path[self._windows[number]] @ self._turns[:, some]).T)

    def _part(self, paths: Sequence[np.ndarray], powers: Powers, number: int, some: slice) -> _Part:
        """Return the covariance of patterns along paths in a window, at some frequencies."""
        window, values = self._windows[number], self._values[number][some]
        turned = [self._phases(path, number, some) for path in paths]
        alike = np.exp(-(((window[:, None] - window) / LENGTHS[:, None, None]) ** 2))
        patterns = [
            np.tensordot(own[:, some].T, alike, 1) * one[:, :, None] * one.conj()[:, None]
            for own, one in zip(powers.patterns, turned, strict=True)
        ]
        covariance = sum(patterns, np.zeros((*values.shape, len(window)), np.complex128))
        diagonal = np.arange(len(window))
        covariance[:, diagonal, diagonal] += powers.noise[some, None]
        inverse, factor = np.linalg.inv(covariance), np.linalg.cholesky(covariance)
        likely = (inverse @ values[..., None])[..., 0]
        height = -2.0 * np.log(factor[:, diagonal, diagonal].real).sum(1) - np.vecdot(values, likely).real
        return _Part(turned, alike, patterns, inverse, likely, height)

    def _derive(self, known: _Part, number: int, some: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return the slope with velocities, (n, 2), and their information, (2 n, 2 n), from some frequencies."""
        numbers, few = self._windows[number].astype(np.float64), slice(None, None, FOR_INFORMATION)
        counts, turns = self._counts[some], self._turns[:, some]
        difference = known.likely[:, :, None] * known.likely.conj()[:, None] - known.inverse
        slope, products = np.zeros((len(known.patterns), 2)), []
        for one, pattern in enumerate(known.patterns):
            shared = (pattern.conj() * difference).imag
            slope[one] = -turns @ (counts * ((shared.sum(2) - shared.sum(1)) @ numbers))
            products.append(known.inverse[few] @ (-1j * (numbers[:, None] - numbers) * pattern[few]))
        traces = np.array([[np.einsum("kts,kst->k", one, other).real for other in products] for one in products])
        squares = FOR_INFORMATION * counts[few] * turns[:, None, few] * turns[:, few]
        information = np.einsum("abk,mnk->manb", squares, traces)
        return slope, information.reshape(2 * len(products), -1)

    def _in_cells(self, values: np.ndarray) -> np.ndarray:
        """Return the means over cells of values (..., frequencies), at each frequency."""
        sums, counts = (np.add.reduceat(one, self._starts, -1) for one in (self._counts * values, self._counts))
        return np.repeat(sums / counts, self._sizes, -1)


def _sum_products(vector: np.ndarray, matrix: np.ndarray, alike: np.ndarray) -> np.ndarray:
    """Return the sums of the elements of v v*, with vectors v (K, frames), times those of matrices (K, frames, frames) and of each of
    some matrices (lengths, frames, frames), (lengths, K)."""
    products = (matrix * vector[:, :, None] * vector.conj()[:, None]).real
    return alike.reshape(len(alike), -1) @ products.reshape(len(vector), -1).T
