"""Grid across the line of sight on which an object is sampled: rays, cells, samples."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim.transport.footprint import LagAxes


@dataclass(frozen=True)
class VisibleSurface:
    """Visible surface on a grid, each array (rows, columns).

    Attributes:
        weight: light carried by a cell, photoelectrons in a pixel per laser photon, float64; relative for a `FlatObject`.
        albedo: effective power albedo, float32: that of a flat Lambertian object of equal brightness, with shading, distance and
            BSDF, scaled so that its sum is that of the surface's own albedo.
        depth_m: behind the object's centre along the line of sight, averaged over the light of a cell.
        part: index of the group of shapes that sends most of the light of a cell, int.
    """

    weight: np.ndarray
    albedo: np.ndarray
    depth_m: np.ndarray
    part: np.ndarray


class GridRays:
    """Rays from the frame centre through a grid of cells across the line of sight, `fineness` x `fineness` per cell.

    Args:
        line: from the frame centre to the grid centre, (3,).
        pitch_m: pitch of the cells (rows, columns). shape: their numbers.
    """

    def __init__(
        self, axes: LagAxes, line: np.ndarray, pitch_m: tuple[float, float], shape: tuple[int, int], fineness: int
    ) -> None:
        self.shape = (shape[0] * fineness, shape[1] * fineness)
        row, column = (
            (np.arange(n) - 0.5 * (n - 1)) * (pitch / fineness) for n, pitch in zip(self.shape, pitch_m, strict=True)
        )
        self.place = (row[:, None, None] * axes.down + column[None, :, None] * axes.right).reshape(-1, 3)
        line_of_sight = line / np.linalg.norm(line)
        ray_m = self.place + line
        self.length = np.linalg.norm(ray_m, axis=1)
        self.direction = ray_m / self.length[:, None]
        self.cosine = self.direction @ line_of_sight
        self.area = pitch_m[0] * pitch_m[1] * axes.cell / fineness**2
        self.angle = self.grid(self.area * self.cosine / self.length**2)

    def grid(self, values: np.ndarray) -> np.ndarray:
        return values.reshape(self.shape)


def points(vectors: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(vectors.T, np.float32)


def cell_sums(values: np.ndarray, shape: tuple[int, int], fineness: int) -> np.ndarray:
    return values.reshape(shape[0], fineness, shape[1], fineness).sum((1, 3))


def cells(extent_m: float, pitch_m: float, like: int) -> int:
    """Return the number of cells that cover an extent, even or odd like `like`, so that both grids have the same centre."""
    needed = math.ceil(extent_m / pitch_m)
    return needed + (like - needed) % 2


def centre_in(part: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    whole = np.zeros(shape, part.dtype)
    first = [(n - m) // 2 for n, m in zip(shape, part.shape, strict=True)]
    whole[first[0] : first[0] + part.shape[0], first[1] : first[1] + part.shape[1]] = part
    return whole
