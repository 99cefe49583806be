"""What every kernel propagates between: scatterers near the object's centre, and the pixels of the wall.

All kernels return the same quantity. With o the object's centre, s a scatterer, w a pixel, d the distance from o to
the frame's centre and n the direction from o to there, the field is

    E(w) = sum_s a_s K(w, s),    K = d n.(w - s) / r^2  exp(2 pi i (r - r_o) / lambda),    r = |w - s|, r_o = |w - o|:

the first Rayleigh-Sommerfeld integral (Goodman, Introduction to Fourier Optics, Eq. 3-43) with k r >> 1, its carrier
at each pixel removed and its scale taken from the frame's centre. The carrier has modulus 1 and is the same for all
scatterers, so it drops out of the intensity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.fft import next_fast_len

BORDER = 8
"""Pixels around the frame whose light the camera's blur brings into it; both are computed and the border is cut off."""

GRAINS_APART = 8
"""Grains between one edge of the frame and the next period's other edge: their speckle correlates by (1 / 8 pi)^2 at most."""


def canvas(frame_shape: tuple[int, int]) -> tuple[int, int]:
    """Pixels (rows, columns) of a frame with its border, `BORDER` pixels or a few more for a size that FFTs are fast for."""

    def fast(side: int) -> int:
        return next(n for n in range(side + 2 * BORDER, 2 * (side + 2 * BORDER) + 2, 2) if next_fast_len(n) == n)

    return fast(frame_shape[0]), fast(frame_shape[1])


def period(shape: tuple[int, int], grain_pixels: tuple[float, float]) -> tuple[int, int]:
    """Pixels after which the field of scatterers on a lattice repeats, of a size that FFTs are fast for.

    Wider than `shape` by `GRAINS_APART` grains, so that opposite edges do not share speckle; no more than twice as wide,
    because a frame with fewer grains than that has no statistics to spoil. The autocorrelation of what is cut
    out is unbiased up to the largest patch: its triangle window ends before the next period begins.

    Args:
        shape: rows and columns looked at. grain_pixels: size of a grain along each.
    """
    rows, columns = (
        next_fast_len(min(2 * n, n + int(np.ceil(GRAINS_APART * min(grain, n)))))
        for n, grain in zip(shape, grain_pixels, strict=True)
    )
    return rows, columns


def middle(field: Any, shape: tuple[int, int]) -> Any:
    """The middle (rows, columns) of an array or tensor (..., H, W)."""
    top, left = ((have - want) // 2 for have, want in zip(field.shape[-2:], shape, strict=True))
    return field[..., top : top + shape[0], left : left + shape[1]]


@dataclass(frozen=True)
class Lattice:
    """Where scatterers stand on the object's grid, whose pitch is lambda d / (period x pixel pitch).

    Attributes:
        place: row and column of each scatterer, (n,) each.
        shape: rows and columns of the grid, centred on the object.
        period: pixels (rows, columns) after which the field on the wall repeats.
    """

    place: tuple[np.ndarray, np.ndarray]
    shape: tuple[int, int]
    period: tuple[int, int]

    def grid(self, amplitude: np.ndarray) -> np.ndarray:
        """Amplitudes (n,) on the grid, complex64 (rows, columns)."""
        field = np.zeros(self.shape, np.complex64)
        field[self.place] = amplitude
        return field


@dataclass(frozen=True)
class Scatterers:
    """Points of the object: positions from its centre, float64 (n, 3), and complex amplitudes (n,).

    `lattice` is wanted by kernels that are one FFT.
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
        centre_m: from the object's centre to the frame's, (3,).
        right, down: steps from a pixel to the next along rows and columns, per metre of pitch, (3,); not of length 1 and not
            perpendicular where the camera looks at the wall at an angle.
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
        """Distance of each row and of each column from the frame's centre, (H,) and (W,)."""
        height, width = self.shape
        return ((np.arange(height) - 0.5 * (height - 1)) * self.pitch_m, (np.arange(width) - 0.5 * (width - 1)) * self.pitch_m)

    def pixels(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Positions from the object's centre of pixels (row, column), whole or not, broadcast; (..., 3)."""
        height, width = self.shape
        down = (np.asarray(row, np.float64) - 0.5 * (height - 1)) * self.pitch_m
        right = (np.asarray(column, np.float64) - 0.5 * (width - 1)) * self.pitch_m
        return self.centre_m + down[..., None] * self.down + right[..., None] * self.right


def path_difference(pixel_m: np.ndarray, scatterer_m: np.ndarray) -> np.ndarray:
    """r - r_o in metres without the loss of digits of a plain difference; (..., 3) each, broadcast."""
    distance = np.linalg.norm(pixel_m - scatterer_m, axis=-1) + np.linalg.norm(pixel_m, axis=-1)
    return ((scatterer_m - 2.0 * pixel_m) * scatterer_m).sum(-1) / distance


def phasor(path_m: np.ndarray, wavelength_m: float) -> np.ndarray:
    """exp(2 pi i path / lambda), whole turns taken out first."""
    turns = path_m / wavelength_m
    return np.exp(2j * np.pi * (turns - np.round(turns)))


def kernel(wall: Wall, pixel_m: np.ndarray, scatterer_m: np.ndarray) -> np.ndarray:
    """K in float64, for pairs of positions (..., 3), broadcast."""
    ray = pixel_m - scatterer_m
    along = (ray * wall.centre_m).sum(-1)  # d n.(w - s)
    return along / (ray * ray).sum(-1) * phasor(path_difference(pixel_m, scatterer_m), wall.wavelength_m)
