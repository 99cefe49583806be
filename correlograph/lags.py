"""Lag grids of estimates and albedos.

Shapes in docstrings are those of the default, 63 lags: estimates (127, 127), albedos (64, 64), padded albedos (128, 128).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

LAGS = 63
"""Largest lag on either side of zero by default, and in published estimates: 127 x 127, zero lag at [63, 63]."""

LAG_SIDE = 2 * LAGS + 1
"""Side of an estimate by default."""

OBJECT_SIDE = LAGS + 1
"""Side of an albedo by default."""


@dataclass(frozen=True)
class LagGrid:
    """Square grid of lags from `-lags` to `lags` along rows and columns; get one from `lag_grid` or `lag_grid_of`."""

    lags: int

    @property
    def side(self) -> int:
        """Side of an estimate."""
        return 2 * self.lags + 1

    @property
    def object_side(self) -> int:
        """Side of an albedo on the lag grid."""
        return self.lags + 1

    @property
    def padded_side(self) -> int:
        """Side of the periodic grid on which the periodic autocorrelation of an albedo does not wrap around."""
        return 2 * self.lags + 2

    @cached_property
    def steps(self) -> np.ndarray:
        """Lags along one axis, (side,)."""
        return np.arange(-self.lags, self.lags + 1)

    @cached_property
    def row(self) -> np.ndarray:
        """Row lag at every place, (side, side)."""
        return np.repeat(self.steps[:, None], self.side, 1)

    @cached_property
    def column(self) -> np.ndarray:
        """Column lag at every place, (side, side)."""
        return np.repeat(self.steps[None, :], self.side, 0)

    @cached_property
    def ring(self) -> np.ndarray:
        """Number of the square ring of every lag, max(|row|, |column|): the autocorrelation of an object in a square support
        lies inside one ring.
        """
        return np.maximum(np.abs(self.row), np.abs(self.column))

    @cached_property
    def half_plane(self) -> np.ndarray:
        """One lag of every equal pair (+lag and -lag), without zero lag."""
        return (self.row > 0) | ((self.row == 0) & (self.column > 0))

    @cached_property
    def off_axis(self) -> np.ndarray:
        """Independent lags outside the row and column through zero lag, which contain the read noise of lines."""
        return self.half_plane & (self.row != 0) & (self.column != 0)


@lru_cache(maxsize=16)
def lag_grid(lags: int) -> LagGrid:
    """Return the grid with a number of lags on either side of zero."""
    return LagGrid(lags)


def lag_grid_of(estimate: object) -> LagGrid:
    """Return the grid of an array of lags (..., side, side)."""
    return lag_grid(estimate.shape[-1] // 2)  # type: ignore[attr-defined]
