"""Objects of sixteen kinds that no training target shows: dots, discs, rings, gratings, gradients, spirals and others.

Each function draws an object at random on a grid four times finer than the lags, 0 to 1; `draw_unusual` averages over lags.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter

from correlograph.lags import OBJECT_SIDE

FINE = 4
"""Cells per lag along each axis, before the average."""

HALF_LAGS = OBJECT_SIDE / 2

_LAG = (np.arange(OBJECT_SIDE * FINE) + 0.5) / FINE - HALF_LAGS
ROW, COLUMN = np.meshgrid(_LAG, _LAG, indexing="ij")
"""Coordinates of the fine grid in lags from the middle."""

Kind = Callable[[np.random.Generator], np.ndarray]


def _disc(row: float, column: float, radius: float) -> np.ndarray:
    return 1.0 * (np.hypot(ROW - row, COLUMN - column) < radius)


def _rotate_axes(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the coordinates after a random rotation."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.cos(angle) * ROW - np.sin(angle) * COLUMN, np.sin(angle) * ROW + np.cos(angle) * COLUMN


def _box(rng: np.random.Generator, low: float = 10.0, high: float = 20.0) -> np.ndarray:
    """Return a turned rectangle of random half sides."""
    down, right = _rotate_axes(rng)
    half = rng.uniform(low, high, 2)
    return (np.abs(down) < half[0]) & (np.abs(right) < half[1])


def nine_discs(rng: np.random.Generator) -> np.ndarray:
    return np.max([_disc(*rng.uniform(-20.0, 20.0, 2), rng.uniform(1.0, 2.5)) for _ in range(9)], 0)


def two_discs(rng: np.random.Generator) -> np.ndarray:
    return np.max([_disc(*rng.uniform(-15.0, 15.0, 2), rng.uniform(1.5, 4.0)) for _ in range(2)], 0)


def rings(rng: np.random.Generator) -> np.ndarray:
    drawn = np.zeros_like(ROW)
    for _ in range(rng.integers(1, 4)):
        radius, width = rng.uniform(5.0, 12.0), rng.uniform(1.0, 2.5)
        away = np.hypot(ROW - rng.uniform(-10.0, 10.0), COLUMN - rng.uniform(-10.0, 10.0))
        drawn = np.maximum(drawn, np.abs(away - radius) < width)
    return drawn


def random_dots(rng: np.random.Generator) -> np.ndarray:
    drawn = np.zeros_like(ROW)
    for row, column in rng.uniform(-18.0, 18.0, (rng.integers(15, 50), 2)):
        drawn = np.maximum(drawn, rng.uniform(0.4, 1.0) * _disc(row, column, 0.7))
    return drawn


def grating(rng: np.random.Generator) -> np.ndarray:
    down, _ = _rotate_axes(rng)
    return _box(rng) * (np.sin(2.0 * np.pi * down / rng.uniform(4.0, 10.0)) > rng.uniform(-0.5, 0.5))


def checkerboard(rng: np.random.Generator) -> np.ndarray:
    down, right = _rotate_axes(rng)
    cell = rng.uniform(3.0, 8.0)
    half = cell * rng.integers(2, 5)
    inside = (np.abs(down) < min(half, 20.0)) & (np.abs(right) < min(half, 20.0))
    return inside * (np.floor(down / cell) + np.floor(right / cell)) % 2


def soft_blobs(rng: np.random.Generator) -> np.ndarray:
    drawn = np.zeros_like(ROW)
    for _ in range(rng.integers(2, 6)):
        row, column, width = *rng.uniform(-12.0, 12.0, 2), rng.uniform(2.0, 5.0)
        drawn += rng.uniform(0.3, 1.0) * np.exp(-0.5 * ((ROW - row) ** 2 + (COLUMN - column) ** 2) / width**2)
    return drawn


def gradient(rng: np.random.Generator) -> np.ndarray:
    down, _ = _rotate_axes(rng)
    box = _box(rng)
    level = np.where(box, down, np.nan)
    return np.nan_to_num((level - np.nanmin(level)) / np.ptp(level[box]))


def spiral(rng: np.random.Generator) -> np.ndarray:
    radius, angle = np.hypot(ROW, COLUMN), np.arctan2(*_rotate_axes(rng))
    pitch, turns = rng.uniform(5.0, 8.0), rng.uniform(1.5, 3.0)
    apart = (radius - pitch * angle / (2.0 * np.pi)) % pitch
    return (np.minimum(apart, pitch - apart) < rng.uniform(0.6, 1.5)) & (radius < min(turns * pitch, 22.0))


def random_patches(rng: np.random.Generator) -> np.ndarray:
    drawn = np.zeros_like(ROW)
    for _ in range(rng.integers(3, 8)):
        row, column = rng.uniform(-14.0, 14.0, 2)
        height, width = rng.uniform(2.0, 8.0, 2)
        drawn = np.where((np.abs(ROW - row) < height) & (np.abs(COLUMN - column) < width), rng.uniform(0.2, 1.0), drawn)
    return drawn


def mirror_symmetric(rng: np.random.Generator) -> np.ndarray:
    half = nine_discs(rng) if rng.random() < 0.5 else random_patches(rng)
    return np.maximum(half, half[:, ::-1])


def thin_lines(rng: np.random.Generator) -> np.ndarray:
    drawn = np.zeros_like(ROW)
    for _ in range(rng.integers(3, 9)):
        ends = rng.uniform(-20.0, 20.0, (2, 2))
        along = ends[1] - ends[0]
        place = np.clip(((ROW - ends[0, 0]) * along[0] + (COLUMN - ends[0, 1]) * along[1]) / (along @ along), 0.0, 1.0)
        drawn = np.maximum(drawn, np.hypot(ROW - ends[0, 0] - place * along[0], COLUMN - ends[0, 1] - place * along[1]) < 0.35)
    return drawn


def faint_parts(rng: np.random.Generator) -> np.ndarray:
    bright, faint = _disc(*rng.uniform(-10.0, 10.0, 2), rng.uniform(2.0, 5.0)), random_patches(rng) > 0.0
    return np.maximum(bright, rng.uniform(0.1, 0.3) * faint)


def star(rng: np.random.Generator) -> np.ndarray:
    down, right = _rotate_axes(rng)
    points = rng.integers(3, 9)
    outline = 12.0 + rng.uniform(3.0, 8.0) * np.cos(points * np.arctan2(down, right))
    return 1.0 * (np.hypot(down, right) < outline)


def cloud(rng: np.random.Generator) -> np.ndarray:
    smooth = gaussian_filter(rng.standard_normal(ROW.shape), rng.uniform(2.0, 5.0) * FINE)
    level = (smooth - smooth.min()) / np.ptp(smooth)
    return np.clip(level - 0.3, 0.0, None) * _box(rng)


def zigzag(rng: np.random.Generator) -> np.ndarray:
    down, right = _rotate_axes(rng)
    period, height = rng.uniform(8.0, 14.0), rng.uniform(4.0, 9.0)
    centre = height * (4.0 * np.abs((right / period) % 1.0 - 0.5) - 1.0)
    return (np.abs(down - centre) < rng.uniform(1.0, 3.0)) & (np.abs(right) < 20.0)


KINDS: tuple[Kind, ...] = (
    nine_discs,
    two_discs,
    rings,
    random_dots,
    grating,
    checkerboard,
    soft_blobs,
    gradient,
    spiral,
    random_patches,
    mirror_symmetric,
    thin_lines,
    faint_parts,
    star,
    cloud,
    zigzag,
)


def draw_unusual(kind: Kind, rng: np.random.Generator) -> np.ndarray:
    """Return an object of a kind, float32 (64, 64), maximum 1."""
    fine = np.asarray(kind(rng), np.float64).reshape(OBJECT_SIDE, FINE, OBJECT_SIDE, FINE)
    cells = fine.mean((1, 3))
    return (cells / max(cells.max(), 1e-6)).astype(np.float32)
