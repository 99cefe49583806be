"""Light that frames have in common, explained by the paths of some objects.

The cross-spectrum of frames t and t + l at a frequency f is the sum of S_k(f) exp(-2 pi i f (p_k(t + l) - p_k(t))) over objects k with
paths p_k, plus noise with the variance (S + b)^2, where S is the power of all speckle and b that of the noise. The powers S_k of the
objects at this distance l, constants of at least zero in cells of neighbouring frequencies, are fitted by least squares. What the fit
takes from the sum of squares, in units of the variance, is what the paths explain: of noise alone, a path explains half a unit per cell.

Whatever belongs to a maximum, such as the side maxima of its object, is explained with it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invert.tracking.band import Band
from invert.tracking.parts import on_all_cores, parts_of_rows
from invert.tracking.shifts import move_back

CELL = 9
"""Side of a cell in frequencies."""

MAX_POWER = 1.5
"""Largest fitted power of an object over that of all speckle; the rest is noise of the fit."""

RIDGE = 1e-3
"""Regularisation of the fit, over the mean diagonal, where two paths have not moved apart."""


class Explained:
    """Fits of the powers of objects that move along known paths.

    Attributes:
        lags: distances of frames.
        cells: number of cells of frequencies.
    """

    def __init__(self, spectra: np.ndarray, band: Band, lags: Sequence[int]) -> None:
        """Take spectra (frames, R, C) of more frames than the largest distance."""
        self.lags = tuple(lags)
        self.cells = float((band.counts > 0.0).sum()) / CELL**2
        self._spectra, self._band = spectra, band
        self._weight = band.counts / np.maximum(band.signal + band.floor, 1e-300) ** 2
        whole = _in_cells(self._weight)
        self._most = MAX_POWER * _in_cells(self._weight * band.signal) / np.maximum(whole, 1e-300)
        self._counts = _in_cells(band.counts)
        self._paths: list[np.ndarray] = []
        self._seen: list[np.ndarray] = []
        self._shared: dict[tuple[int, int], np.ndarray] = {}

    def add(self, path: np.ndarray) -> int:
        """Take a path (frames, 2), and return its number."""

        def seen(rows: slice) -> np.ndarray:
            moved, weight = move_back(self._spectra[:, rows], self._band.part(rows), path), self._weight[rows]
            return np.stack([_in_cells(weight * np.vecdot(moved[:-lag], moved[lag:], axis=0).real) for lag in self.lags])

        self._paths.append(path)
        self._seen.append(np.concatenate(on_all_cores(seen, parts_of_rows(self._spectra, CELL)), 1))
        return len(self._paths) - 1

    def by(self, numbers: Sequence[int]) -> float:
        """Return what paths explain together, as the mean over the distances of frames."""
        return self._fit(numbers)[1] if numbers else 0.0

    def powers(self, numbers: Sequence[int]) -> np.ndarray:
        """Return the fitted power of each object as a share of that of all speckle, the mean over the distances of frames, (n,)."""
        return (self._fit(numbers)[0] * self._counts[:, None]).sum(1).mean(0) * MAX_POWER / (self._most * self._counts).sum()

    def _fit(self, numbers: Sequence[int]) -> tuple[np.ndarray, float]:
        """Return the powers in each cell, (distances, cells, n), and what they explain."""
        seen = np.stack([self._seen[one] for one in numbers], -1)
        shared = np.stack([np.stack([self._shared_by(one, other) for other in numbers], -1) for one in numbers], -2)
        trace = np.trace(shared, axis1=-2, axis2=-1)[..., None, None] / len(numbers)
        solved = np.linalg.solve(shared + (RIDGE * trace + 1e-300) * np.eye(len(numbers)), seen[..., None])[..., 0]
        powers = np.clip(solved, 0.0, self._most[:, None])
        left = 2.0 * (powers * seen).sum() - np.einsum("lci,lcij,lcj->", powers, shared, powers)
        return powers, float(left) / len(self.lags)

    def _shared_by(self, one: int, other: int) -> np.ndarray:
        """Return the normal equations' element of two paths, (distances, cells)."""
        key = (min(one, other), max(one, other))
        if key not in self._shared:
            relative = 2j * np.pi * (self._paths[one] - self._paths[other])
            steps = (relative[lag:] - relative[:-lag] for lag in self.lags)
            turned = (
                np.exp(np.outer(self._band.rows, step[:, 0])) @ np.exp(np.outer(step[:, 1], self._band.columns))
                for step in steps
            )
            self._shared[key] = np.stack([_in_cells(self._weight * each.real) for each in turned])
        return self._shared[key]


def _in_cells(values: np.ndarray) -> np.ndarray:
    """Return the sums over cells of values (R, C), (cells,)."""
    rows, columns = (np.arange(0, side, CELL) for side in values.shape)
    return np.add.reduceat(np.add.reduceat(values, rows, 0), columns, 1).ravel()
