"""Likelihood that the patterns of some objects are all that frames show.

In a block of B consecutive frames, the spectra at a frequency f are the sum of a_k exp(-2 pi i f p_k(t)) over objects k with paths p_k(t),
plus noise. An orthonormal basis of these n patterns takes n of the B dimensions; the others hold noise. Each of these n coordinates, and
the noise, is Gaussian and has a variance of its own in cells of neighbouring frequencies: the mean of its squares. Up to a constant, the
logarithm of the likelihood is therefore minus the sum of the logarithms of these means, each times the number of its coefficients. Blocks
are as long as makes the frames most likely. A pattern that changes with its illumination is a_k + b_k t + c_k t^2, of up to three modes.

The interference of two objects is two more patterns (`interference.py`), whose phases turn: a track is a path with phases as a third
column.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np

from invert.tracking.band import Band
from invert.tracking.explained import CELL

WHOLE = 2**20
"""Number of values of the spectra by which paths are compared."""

LENGTHS = (4, 8, 16, 32)
"""Approximate numbers of frames in a block."""

RIDGE = 1e-3
"""Part of a pattern outside those of other objects at which its coordinate counts by half."""

FLOOR = 1e-6
"""Least variance over the mean power."""


@dataclass(frozen=True)
class Pattern:
    """Spectra moved back along a track (frames that count, 3): sums over the blocks of each length, times each mode, (modes, blocks,
    frequencies)."""

    track: np.ndarray
    sums: list[np.ndarray]


@dataclass(frozen=True)
class _Coordinate:
    """Squares of a coordinate, and the part of the noise that it holds, (blocks, frequencies) each."""

    squares: np.ndarray
    noise: np.ndarray


_Shared = dict[tuple[int, int], list[np.ndarray]]


class Likelihood:
    """Likelihood of the paths of objects, from spectra (frames, R, C).

    Args:
        most: about the largest number of values of the spectra that are used, at evenly spaced frequencies; about half as many at least.
        used: whether each frame counts, bool (frames,); all do by default.

    Attributes:
        frequencies: number of frequencies.
        cells: number of cells of frequencies.
    """

    def __init__(self, spectra: np.ndarray, band: Band, most: int, used: np.ndarray | None = None) -> None:
        self._used = np.flatnonzero(np.ones(len(spectra), bool) if used is None else used)
        every = max(1.0, (band.counts > 0.0).sum() * len(spectra) / most)
        down = int(np.ceil(every**0.5))
        rows, columns, self._starts = frequencies_in_cells(band, (down, int(np.ceil(every / down))), CELL)
        self._rows, self._columns = rows, columns
        self.frequencies, self.cells = len(rows), len(self._starts)
        self._band, self._spectra = band, spectra[self._used[:, None], self._rows, self._columns]
        # Two conjugate coefficients are one, and the window correlates neighbours.
        self._counts = 0.5 * band.counts[self._rows, self._columns] / band.noise_gain
        frames, power = np.arange(len(self._used)), np.abs(self._spectra) ** 2
        numbers = dict.fromkeys(max(1, len(frames) // length) for length in LENGTHS)
        self._blocks = [np.array_split(frames, number) for number in numbers]
        self._powers = [_sums(power, blocks) for blocks in self._blocks]
        self._floor = FLOOR * float((self._counts * power.mean(0)).sum() / self._counts.sum())
        self._none = self.of([])

    def pattern(self, path: np.ndarray, modes: int = 1) -> Pattern:
        """Return what moves along a path (frames, 2) or a track (frames, 3), of some modes."""
        track = np.pad(path, ((0, 0), (0, 3 - path.shape[1])))[self._used]
        moved = self._phases(track)
        moved *= self._spectra
        sums = []
        for blocks in self._blocks:
            sums.append(np.stack([_sums(moved * one[:, None], blocks) for one in _weights(blocks, modes)]))
        return Pattern(track, sums)

    def of(self, patterns: Sequence[Pattern]) -> float:
        """Return the logarithm of the likelihood of patterns, all of the same number of modes."""
        return max(self._at_lengths(patterns))

    def rise(self, paths: Sequence[np.ndarray], modes: int = 1) -> float:
        """Return by how much patterns along paths (frames, 2) or tracks (frames, 3) raise the logarithm of the likelihood of all frames."""
        return self.of([self.pattern(one, modes) for one in paths]) - self._none

    @property
    def block_count(self) -> int:
        """Number of blocks of the longest kind."""
        return len(self._blocks[-1])

    @property
    def longest_block(self) -> int:
        """Number of frames in the longest block."""
        return max(len(block) for block in self._blocks[-1])

    def at_likely_length(self, paths: Sequence[np.ndarray]) -> Likelihood:
        """Return the likelihood by blocks of that length alone at which patterns along paths (frames, 2) or tracks (frames, 3) are the most
        likely."""
        best, found = int(np.argmax(self._at_lengths([self.pattern(one) for one in paths]))), copy(self)
        found._blocks, found._powers = [self._blocks[best]], [self._powers[best]]
        return found

    def _at_lengths(self, patterns: Sequence[Pattern]) -> list[float]:
        """Return the logarithm of the likelihood for blocks of each length."""
        shared, found = self._shared_by(patterns), []
        for length in range(len(self._blocks)):
            coordinates, total = list(self._coordinates(length, patterns, shared)), 0.0
            for one in [*coordinates, self._left(length, coordinates)]:
                numbers = self._in_cells(one.noise)
                mean = self._in_cells(one.squares) / np.maximum(numbers, 1e-9)
                total -= float((numbers * np.log(np.maximum(mean, self._floor))).sum())
            found.append(total)
        return found

    def _left(self, length: int, coordinates: Sequence[_Coordinate]) -> _Coordinate:
        """Return the power that coordinates leave, and the noise that they do not hold."""
        power = self._powers[length]
        left = power - sum((one.squares for one in coordinates), np.zeros(1))
        sizes = np.array([len(block) for block in self._blocks[length]], np.float64)[:, None]
        return _Coordinate(left, sizes - sum((one.noise for one in coordinates), np.zeros(power.shape)))

    def _coordinates(self, length: int, patterns: Sequence[Pattern], shared_by: _Shared) -> Iterator[_Coordinate]:
        """Yield the coordinates in a basis of patterns, by Cholesky's decomposition L of their Gram matrix plus `RIDGE`, in their order."""
        modes = len(patterns[0].sums[length]) if patterns else 0
        lower: list[list[np.ndarray]] = []
        inverse: list[list[np.ndarray]] = []
        found: list[np.ndarray] = []
        for number, one in enumerate(patterns):
            for mode, own in enumerate(one.sums[length].astype(np.complex128)):
                row: list[np.ndarray] = []
                for before in range(len(lower)):
                    other, its_mode = divmod(before, modes)
                    shared = shared_by[number, other][length][mode, its_mode] if other < number else np.zeros(1)
                    done = sum(a * b.conj() for a, b in zip(row, lower[before], strict=False))
                    row.append((shared - done) / lower[before][-1])
                left = 1.0 + RIDGE - sum((np.abs(each) ** 2 for each in row), np.zeros(own.shape))
                scale = np.sqrt(np.maximum(left, 0.5 * RIDGE))
                found.append((own - sum(a * b for a, b in zip(row, found, strict=True))) / scale)
                columns = range(len(row))
                unit = [-sum(row[k] * inverse[k][j] for k in range(j, len(row))) / scale for j in columns] + [1.0 / scale]
                lower.append([*row, scale])
                inverse.append(unit)
                noise = 1.0 - RIDGE * sum((np.abs(each) ** 2 for each in unit), np.zeros(1))
                yield _Coordinate(np.abs(found[-1]) ** 2, np.maximum(noise, 0.0))

    def _shared_by(self, patterns: Sequence[Pattern]) -> _Shared:
        """Return the scalar products of the modes of each pattern with those before it, for each length, (modes, modes, blocks,
        frequencies)."""
        found = {}
        for (first, one), (second, other) in combinations(enumerate(patterns), 2):
            turned, by_length = self._phases(other.track - one.track), []
            for blocks, sums in zip(self._blocks, one.sums, strict=True):
                weights = _weights(blocks, len(sums))
                products = weights[:, None] * weights
                by_length.append(np.stack([[_sums(turned * each[:, None], blocks) for each in row] for row in products]))
            found[second, first] = by_length
        return found

    def _phases(self, track: np.ndarray) -> np.ndarray:
        """Return the phases that move frames back along a track (frames, 3), (frames, frequencies)."""
        rows, columns = (
            np.exp(2j * np.pi * (np.outer(along, frequencies) + phases)).astype(np.complex64)
            for along, frequencies, phases in (
                (track[:, 0], self._band.rows, track[:, 2:]),
                (track[:, 1], self._band.columns, 0.0),
            )
        )
        turned = rows[:, self._rows]
        turned *= columns[:, self._columns]
        return turned

    def _in_cells(self, values: np.ndarray) -> np.ndarray:
        """Return the sums over cells of values (blocks, frequencies), times their counts, (cells,)."""
        return np.add.reduceat(self._counts * values.sum(0), self._starts)


def frequencies_in_cells(band: Band, every: tuple[int, int], side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows and columns of evenly spaced frequencies of a band, cell by cell, and the indices at which cells begin.

    Args:
        every: distances of the frequencies along rows and columns.
        side: side of a cell in these distances.
    """
    down, right = every
    rows, columns = np.nonzero(band.counts > 0.0)
    chosen = (rows % down == 0) & (columns % right == 0)
    rows, columns = rows[chosen], columns[chosen]
    cell = rows // (side * down) * len(band.columns) + columns // (side * right)
    order = np.argsort(cell, kind="stable")
    return rows[order], columns[order], np.flatnonzero(np.diff(cell[order], prepend=-1))


def _weights(blocks: Sequence[np.ndarray], modes: int) -> np.ndarray:
    """Return the modes of all blocks, (modes, frames)."""
    return np.concatenate([_modes(len(block), modes) for block in blocks], 1)


@cache
def _modes(frames: int, modes: int) -> np.ndarray:
    """Return orthonormal polynomials of rising degree, (modes, frames), of at least as many frames as modes."""
    return np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, frames), modes, increasing=True))[0].T.astype(np.float32)


def _sums(values: np.ndarray, blocks: Sequence[np.ndarray]) -> np.ndarray:
    """Return the sums of values (frames, n) over blocks of frames, (blocks, n)."""
    return np.add.reduceat(values, [block[0] for block in blocks], 0)
