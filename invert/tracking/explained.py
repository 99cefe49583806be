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
    """Fits of the powers of objects that move along paths.

    Attributes:
        cells: number of cells of frequencies.
    """

    def __init__(self, spectra: np.ndarray, band: Band, lags: Sequence[int]) -> None:
        """Take spectra (frames, R, C) of more frames than the largest of some distances."""
        self.cells = float((band.counts > 0.0).sum()) / CELL**2
        self._spectra, self._band, self._lags = spectra, band, tuple(lags)
        self._weight = band.counts / np.maximum(band.signal + band.floor, 1e-300) ** 2
        whole = _in_cells(self._weight)
        self._most = MAX_POWER * _in_cells(self._weight * band.signal) / np.maximum(whole, 1e-300)
        self._counts = _in_cells(band.counts)

    def fit(self, paths: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
        """Return the power of the speckle along each path (frames, 2) as a share of that of all speckle, (n,), and what the paths explain
        together, both as the mean over the distances of frames."""
        seen = np.stack([self._seen(one) for one in paths], -1)
        shared = np.empty((*seen.shape, len(paths)))
        for one, path in enumerate(paths):
            for other in range(one + 1):
                shared[..., one, other] = shared[..., other, one] = self._shared(path - paths[other])
        trace = np.trace(shared, axis1=-2, axis2=-1)[..., None, None] / len(paths)
        solved = np.linalg.solve(shared + (RIDGE * trace + 1e-300) * np.eye(len(paths)), seen[..., None])[..., 0]
        powers = np.clip(solved, 0.0, self._most[:, None])
        left = 2.0 * (powers * seen).sum() - np.einsum("lci,lcij,lcj->", powers, shared, powers)
        shares = (powers * self._counts[:, None]).sum(1).mean(0) * MAX_POWER / (self._most * self._counts).sum()
        return shares, float(left) / len(self._lags)

    def _seen(self, path: np.ndarray) -> np.ndarray:
        """Return the weighted cross-spectra along a path, (distances, cells)."""

        def in_rows(rows: slice) -> np.ndarray:
            moved, weight = move_back(self._spectra[:, rows], self._band.part(rows), path), self._weight[rows]
            return np.stack([_in_cells(weight * np.vecdot(moved[:-lag], moved[lag:], axis=0).real) for lag in self._lags])

        return np.concatenate(on_all_cores(in_rows, parts_of_rows(self._spectra, CELL)), 1)

    def _shared(self, relative: np.ndarray) -> np.ndarray:
        """Return the normal equations' element of two paths that differ by `relative` (frames, 2), (distances, cells)."""
        steps = (2j * np.pi * (relative[lag:] - relative[:-lag]) for lag in self._lags)
        turned = (
            np.exp(np.outer(self._band.rows, step[:, 0])) @ np.exp(np.outer(step[:, 1], self._band.columns)) for step in steps
        )
        return np.stack([_in_cells(self._weight * each.real) for each in turned])


def _in_cells(values: np.ndarray) -> np.ndarray:
    """Return the sums over cells of values (R, C), (cells,)."""
    rows, columns = (np.arange(0, side, CELL) for side in values.shape)
    return np.add.reduceat(np.add.reduceat(values, rows, 0), columns, 1).ravel()
