"""The hidden object as the virtual detector sees it: albedo and cosines on any grid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from radiometry.errors import InputError
from sim.plugins.phase_screen import PhaseScreen
from sim.propagation.direct import Visibility

MEASURING_GRID = 512
"""Samples along the longer side of the object when its area and cosines are measured."""


def is_hidden_object(shape: mi.Shape) -> bool:
    return shape.id().startswith("hidden_object")


@dataclass(frozen=True)
class Samples:
    """Visible surface on a grid, each array (rows, columns): power albedo (0 where nothing is seen or
    where light from the virtual source does not arrive), cosines towards source and detector, and depth
    behind the object's centre along the line of sight."""

    albedo: np.ndarray
    cosine_in: np.ndarray
    cosine_out: np.ndarray
    depth_m: np.ndarray


class HiddenObject:
    """All shapes whose id starts with `hidden_object`, seen along the line from the virtual detector.

    Grid rows run along `down`, columns along `right`, both made perpendicular to that line.
    """

    def __init__(self, scene: mi.Scene, detector: np.ndarray, spot: np.ndarray, right: np.ndarray,
                 down: np.ndarray) -> None:
        boxes = [shape.bbox() for shape in scene.shapes() if is_hidden_object(shape)]
        low = np.min([np.asarray(box.min, np.float64) for box in boxes], axis=0)
        high = np.max([np.asarray(box.max, np.float64) for box in boxes], axis=0)
        self._scene, self._detector, self._spot = scene, detector, spot
        self.centre = 0.5 * (low + high)
        line = self.centre - detector
        self.line_of_sight = line / np.linalg.norm(line)
        self.right = _perpendicular(right, self.line_of_sight)
        self.down = _perpendicular(down, self.line_of_sight)
        if not np.isfinite([low, high]).all() or np.abs([low, high]).max() > 1e9:
            raise InputError("hidden_object", "a finite place and size", f"{low} to {high}", "correct its to_world")
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        corners -= self.centre
        self.extent_m = (float(np.ptp(corners @ self.down)), float(np.ptp(corners @ self.right)))
        self.depth_m = float(np.ptp(corners @ self.line_of_sight))
        if min(self.extent_m) <= 1e-6 * max(self.extent_m):
            raise InputError("hidden_object", "a shape with a surface towards the virtual detector",
                             f"{self.extent_m[1]:g} x {self.extent_m[0]:g} m", "correct its to_world")
        self._measured = self._measure()
        self.height_rms_m = min((shape.bsdf().height_rms_m for shape in scene.shapes()
                                 if is_hidden_object(shape) and isinstance(shape.bsdf(), PhaseScreen)), default=math.inf)
        """Smallest surface roughness; a BSDF that is no phase_screen counts as rough."""

    def sample(self, pitch_m: tuple[float, float], shape: tuple[int, int]) -> Samples:
        """Sample at the cell centres of a grid (rows, columns) centred on the object."""
        scene = self._scene
        row = (np.arange(shape[0]) - 0.5 * (shape[0] - 1)) * pitch_m[0]
        column = (np.arange(shape[1]) - 0.5 * (shape[1] - 1)) * pitch_m[1]
        offset = row[:, None, None] * self.down + column[None, :, None] * self.right
        back = self.depth_m + max(self.extent_m)
        start = self.centre + offset - back * self.line_of_sight
        origin = mi.Point3f(np.ascontiguousarray(start.reshape(-1, 3).T, np.float32))
        hit = scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(*self.line_of_sight.tolist())))
        mine = dr.zeros(mi.Bool, dr.width(origin))
        for candidate in scene.shapes():
            if is_hidden_object(candidate):
                mine |= hit.shape == mi.ShapePtr(candidate)
        mine &= hit.is_valid()
        to_spot = dr.normalize(mi.Point3f(*self._spot.tolist()) - hit.p)
        cosine_in = dr.dot(hit.n, to_spot)
        cosine_out = dr.dot(hit.n, mi.Vector3f(*(-self.line_of_sight).tolist()))
        lit = mine & (cosine_in > 0.0) & (cosine_out > 0.0)
        lit &= ~scene.ray_test(hit.spawn_ray_to(mi.Point3f(*self._spot.tolist()) - 1e-4 * to_spot), lit)
        lit &= ~scene.ray_test(hit.spawn_ray_to(mi.Point3f(*(self._detector + 1e-4 * self.line_of_sight).tolist())), lit)
        albedo = dr.select(lit, hit.bsdf().eval_diffuse_reflectance(hit, lit)[0], 0.0)

        def grid(values: mi.Float) -> np.ndarray:
            return np.asarray(values, np.float32).reshape(shape)

        return Samples(grid(albedo), grid(dr.select(lit, cosine_in, 0.0)), grid(dr.select(lit, cosine_out, 0.0)),
                       grid(dr.select(lit, hit.t - back, 0.0)))

    def cell_means(self, pitch_m: float, side: int, subsamples: int = 8) -> np.ndarray:
        """Albedo averaged over each cell of a square grid, float32 (side, side): the integral of r is kept."""
        fine = self.sample((pitch_m / subsamples, pitch_m / subsamples), (side * subsamples, side * subsamples)).albedo
        return fine.reshape(side, subsamples, side, subsamples).mean((1, 3))

    def visible_from(self, detector: np.ndarray, wall_centre_m: np.ndarray) -> Visibility | None:
        """Ray tests between places on the wall and samples of the object; None where nothing can stand between them.

        Args:
            detector: the frame's centre in the world, `wall_centre_m` from the object's centre.
        """
        scene, origin = self._scene, detector - wall_centre_m
        named = ("virtual_source", "virtual_detector")
        if all(is_hidden_object(shape) or shape.id() in named for shape in scene.shapes()) and self.depth_m == 0.0:
            return None

        def visible(places: np.ndarray, samples: np.ndarray) -> np.ndarray:
            way = samples[None] - places[:, None]
            length = np.linalg.norm(way, axis=-1, keepdims=True)
            start = (origin + places)[:, None] + 1e-4 * way
            ray = mi.Ray3f(mi.Point3f(np.ascontiguousarray(start.reshape(-1, 3).T, np.float32)),
                           mi.Vector3f(np.ascontiguousarray((way / length).reshape(-1, 3).T, np.float32)))
            ray.maxt = mi.Float(np.ascontiguousarray((length * (1.0 - 1e-3)).ravel(), np.float32))
            return ~np.asarray(scene.ray_test(ray)).reshape(way.shape[:2])

        return visible

    def _measure(self) -> tuple[float, float, float]:
        """Albedo-weighted area of the surface, and mean cosines in and out weighted by it."""
        pitch = max(self.extent_m) / MEASURING_GRID
        shape = tuple(int(np.ceil(extent / pitch)) or 1 for extent in self.extent_m)
        seen = self.sample((pitch, pitch), (shape[0], shape[1]))
        if float(seen.albedo.max()) > 1.0 + 1e-4:
            raise InputError("hidden_object", "an albedo of at most 1", float(seen.albedo.max()), "correct its reflectance")
        lit = seen.cosine_out > 0.0
        area = np.where(lit, seen.albedo / np.where(lit, seen.cosine_out, 1.0), 0.0).astype(np.float64) * pitch**2
        total = float(area.sum())
        if not lit.any():
            return 0.0, 1.0, 1.0
        weight = area if total > 0.0 else lit.astype(np.float64)
        return (total, float(np.clip((weight * seen.cosine_in).sum() / weight.sum(), 0.0, 1.0)),
                float(np.clip((weight * seen.cosine_out).sum() / weight.sum(), 0.0, 1.0)))

    def albedo_area_m2(self) -> float:
        """Integral of the albedo over the visible, lit surface."""
        return self._measured[0]

    def mean_cosines(self) -> tuple[float, float]:
        """Mean cosines towards the virtual source and the virtual detector."""
        return self._measured[1], self._measured[2]


class FlatObject:
    """A flat, rough object that faces the virtual detector, given as albedo cells instead of shapes; see `HiddenObject`.

    Args:
        cells: albedo (n, n), 0 to 1, rows down and columns right.
        like: the object whose place and cosines it takes.
    """

    depth_m = 0.0
    height_rms_m = math.inf

    def __init__(self, cells: np.ndarray, pitch_m: float, like: HiddenObject) -> None:
        self._cells, self._pitch_m, self._like = np.asarray(cells, np.float32), pitch_m, like
        self.centre, self.right, self.down, self.line_of_sight = like.centre, like.right, like.down, like.line_of_sight
        filled = self._cells > 0.0
        # Twice the distance of the farthest filled cell from the middle, because grids are centred.
        spans = (np.flatnonzero(filled.any(axis)) + np.array([[0], [1]]) - 0.5 * len(filled) for axis in (1, 0))
        self.extent_m = tuple(2.0 * pitch_m * float(np.abs(span).max(initial=0.5)) for span in spans)

    def sample(self, pitch_m: tuple[float, float], shape: tuple[int, int]) -> Samples:
        """Sample at the cell centres of a grid (rows, columns) centred on the object."""
        places = [np.floor((np.arange(n) - 0.5 * (n - 1)) * step / self._pitch_m + 0.5 * len(self._cells)).astype(int)
                  for n, step in zip(shape, pitch_m, strict=True)]
        inside = [(place >= 0) & (place < len(self._cells)) for place in places]
        albedo = np.zeros(shape, np.float32)
        albedo[np.ix_(*inside)] = self._cells[np.ix_(*(place[held] for place, held in zip(places, inside, strict=True)))]
        cosines = [np.where(albedo > 0.0, np.float32(cosine), np.float32(0.0)) for cosine in self.mean_cosines()]
        return Samples(albedo, *cosines, np.zeros(shape, np.float32))

    def albedo_area_m2(self) -> float:
        """Integral of the albedo over the surface."""
        return float(self._cells.sum(dtype=np.float64)) * self._pitch_m**2

    def mean_cosines(self) -> tuple[float, float]:
        return self._like.mean_cosines()

    def visible_from(self, detector: np.ndarray, wall_centre_m: np.ndarray) -> Visibility | None:
        return self._like.visible_from(detector, wall_centre_m)


def _perpendicular(vector: np.ndarray, line: np.ndarray) -> np.ndarray:
    part = vector - line * (vector @ line)
    return part / np.linalg.norm(part)
