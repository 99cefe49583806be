"""A flat object of albedo cells, in place of a scene's own object."""

from __future__ import annotations

import math

import numpy as np

from sim.propagation.option import Visibility
from sim.transport.hidden_object import HiddenObject
from sim.transport.ray_grid import VisibleSurface


class FlatObject:
    """A flat, rough object that faces the virtual detector, defined by albedo cells instead of shapes; see `HiddenObject`.

    Args:
        cells: albedo (n, n), 0 to 1, rows down and columns right.
        pitch_m: pitch of the cells (rows, columns).
        like: object whose position and cosines it takes.
    """

    depth_m = 0.0
    height_rms_m = math.inf

    def __init__(self, cells: np.ndarray, pitch_m: tuple[float, float], like: HiddenObject) -> None:
        self._cells, self._pitch_m, self._like = np.asarray(cells, np.float32), pitch_m, like
        self.centre, self.axes, self.line_of_sight = like.centre, like.axes, like.line_of_sight
        filled = self._cells > 0.0
        # twice the distance of the farthest filled cell from the centre, because grids are centred
        spans = (np.flatnonzero(filled.any(axis)) + np.array([[0], [1]]) - 0.5 * len(filled) for axis in (1, 0))
        self.extent_m = tuple(
            2.0 * pitch * float(np.abs(span).max(initial=0.5)) for span, pitch in zip(spans, pitch_m, strict=True)
        )

    def sample(self, pitch_m: tuple[float, float], shape: tuple[int, int]) -> VisibleSurface:
        """Sample at the cell centres of a grid (rows, columns) centred on the object."""
        places = [
            np.floor((np.arange(n) - 0.5 * (n - 1)) * step / own + 0.5 * len(self._cells)).astype(int)
            for n, step, own in zip(shape, pitch_m, self._pitch_m, strict=True)
        ]
        inside = [(place >= 0) & (place < len(self._cells)) for place in places]
        albedo = np.zeros(shape, np.float32)
        albedo[np.ix_(*inside)] = self._cells[np.ix_(*(place[held] for place, held in zip(places, inside, strict=True)))]
        return VisibleSurface(albedo.astype(np.float64), albedo, np.zeros(shape), np.zeros(shape, int))

    throughput = 0.0

    def position(self, coordinates: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        return self._like.position(coordinates, depth_m)

    def albedo_area_m2(self) -> float:
        """Integral of the albedo over the surface."""
        return float(self._cells.sum(dtype=np.float64)) * self._pitch_m[0] * self._pitch_m[1] * self.axes.cell

    def mean_cosines(self) -> tuple[float, float]:
        return self._like.mean_cosines()

    def visible_from(self, detector: np.ndarray, wall_centre_m: np.ndarray) -> Visibility | None:
        return self._like.visible_from(detector, wall_centre_m)
