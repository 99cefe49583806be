"""Ends of every propagation: scatterers near the object's centre, and pixels of the wall.

All propagators return the same quantity. Let o be the object's centre, s a scatterer, w a pixel, d the distance from o to the
frame centre and n the direction from o to the frame centre. The field is

    E(w) = sum_s a_s K(w, s),    K = d n.(w - s) / r^2  exp(2 pi i (r - r_o) / lambda),    r = |w - s|, r_o = |w - o|:

the first Rayleigh-Sommerfeld integral (Goodman, Introduction to Fourier Optics, Eq. 3-43) with k r >> 1, without its carrier at
each pixel, and normalised to K = 1 between the object's centre and the frame centre. The carrier has modulus 1 and is equal for
all scatterers, so it cancels in the intensity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.fft import next_fast_len

from sim.foreseen import MAX_WAYS

BORDER, BORDER_BLURS = 8, 2.0
"""Least pixels around the frame whose light the blur of the camera brings into it, and the same in widths of this blur; both are computed,
and the border is cut off."""

GRAINS_APART = 8
"""Distance in grains from an edge of the frame to the opposite edge of the next period; the speckle at these edges correlates by
at most (1 / 8 pi)^2."""


def canvas(frame_shape: tuple[int, int], blur_pixels: float) -> tuple[int, int]:
    """Return the pixels (rows, columns) of a frame with its border, rounded up to a fast FFT size; the border is at most as wide as the
    frame.

    Args:
        blur_pixels: width of the camera's blur, lambda times the distance of the pupil over its diameter.
    """

    def fast(side: int) -> int:
        least = side + 2 * max(BORDER, min(side, math.ceil(BORDER_BLURS * blur_pixels)))
        return next(n for n in range(least + least % 2, 2 * least + 2, 2) if next_fast_len(n) == n)

    return fast(frame_shape[0]), fast(frame_shape[1])


def period(
    shape: tuple[int, int], grain_pixels: tuple[float, float], ways: tuple[float, float] = (0.0, 0.0)
) -> tuple[int, int]:
    """Return the pixels after which the field of scatterers on a lattice repeats, of a fast FFT size.

    The period exceeds `shape` by `GRAINS_APART` grains, so that opposite edges share no speckle. It is at most twice as wide, because
    a frame with fewer grains has no useful statistics; wider where the speckle moves farther, up to `MAX_WAYS` frames. The
    autocorrelation of the crop is unbiased up to the largest patch: its triangle window ends before the next period begins.

    Args:
        shape: rows and columns of the crop. grain_pixels: grain size along each axis. ways: pixels by which the speckle moves.
    """
    rows, columns = (
        next_fast_len(n + int(np.ceil(max(min(n, GRAINS_APART * grain), min(way, MAX_WAYS * n)))))
        for n, grain, way in zip(shape, grain_pixels, ways, strict=True)
    )
    return rows, columns


def middle(field: Any, shape: tuple[int, int]) -> Any:
    """Crop the middle (rows, columns) of an array or tensor (..., H, W)."""
    top, left = ((have - want) // 2 for have, want in zip(field.shape[-2:], shape, strict=True))
    return field[..., top : top + shape[0], left : left + shape[1]]


@dataclass(frozen=True)
class Lattice:
    """Positions of scatterers on the object's grid, whose pitch is lambda d / (period x pixel pitch).

    Attributes:
        place: row and column of each scatterer, (n,) each.
        shape: rows and columns of the grid, centred on the object.
        period: pixels (rows, columns) after which the field on the wall repeats.
    """

    place: tuple[np.ndarray, np.ndarray]
    shape: tuple[int, int]
    period: tuple[int, int]

    def grid(self, amplitude: np.ndarray) -> np.ndarray:
        """Return amplitudes (n,) on the grid, complex64 (rows, columns)."""
        field = np.zeros(self.shape, np.complex64)
        field[self.place] = amplitude
        return field


@dataclass(frozen=True)
class Scatterers:
    """Points of the object: positions from its centre, float64 (n, 3), and complex amplitudes (n,).

    Propagators by a single FFT need `lattice`.
    """

    position_m: np.ndarray
    amplitude: np.ndarray
    lattice: Lattice | None = None

    def __len__(self) -> int:
        return len(self.amplitude)


@dataclass(frozen=True)
class Wall:
    """Pixels of a frame on the wall.

    Attributes:
        centre_m: from the object's centre to the frame centre, (3,).
        right, down: steps between adjacent pixels along rows and columns, per metre of pitch, (3,); neither unit vectors nor
            perpendicular if the camera sees the wall at an angle.
        shape: (H, W).
    """

    centre_m: np.ndarray
    right: np.ndarray
    down: np.ndarray
    shape: tuple[int, int]
    pitch_m: float
    wavelength_m: float

    @property
    def distance_m(self) -> float:
        return float(np.linalg.norm(self.centre_m))

    def offsets(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances of rows and of columns from the frame centre, (H,) and (W,)."""
        height, width = self.shape
        return ((np.arange(height) - 0.5 * (height - 1)) * self.pitch_m, (np.arange(width) - 0.5 * (width - 1)) * self.pitch_m)

    def pixels(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return the positions of pixels relative to the object's centre, (..., 3). Rows and columns may be fractions and
        are broadcast.
        """
        height, width = self.shape
        down = (np.asarray(row, np.float64) - 0.5 * (height - 1)) * self.pitch_m
        right = (np.asarray(column, np.float64) - 0.5 * (width - 1)) * self.pitch_m
        return self.centre_m + down[..., None] * self.down + right[..., None] * self.right


def path_difference(pixel_m: np.ndarray, scatterer_m: np.ndarray) -> np.ndarray:
    """Return r - r_o in metres without cancellation error; (..., 3) each, broadcast."""
    distance = np.linalg.norm(pixel_m - scatterer_m, axis=-1) + np.linalg.norm(pixel_m, axis=-1)
    return ((scatterer_m - 2.0 * pixel_m) * scatterer_m).sum(-1) / distance


def phasor(path_m: np.ndarray, wavelength_m: float) -> np.ndarray:
    """Return exp(2 pi i path / lambda), without whole turns."""
    turns = path_m / wavelength_m
    return np.exp(2j * np.pi * (turns - np.round(turns)))


def kernel(wall: Wall, pixel_m: np.ndarray, scatterer_m: np.ndarray) -> np.ndarray:
    """Return K in float64, for pairs of positions (..., 3), broadcast."""
    ray = pixel_m - scatterer_m
    along = (ray * wall.centre_m).sum(-1)  # d n.(w - s)
    return along / (ray * ray).sum(-1) * phasor(path_difference(pixel_m, scatterer_m), wall.wavelength_m)
