"""Patches and their lags, the autocorrelation of an albedo, and the effect of the patch window on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from correlograph.errors import InputError
from correlograph.lags import LAGS, LagGrid, lag_grid, lag_grid_of


@dataclass(frozen=True)
class PatchGrid:
    """Division of a frame into `rows` x `columns` patches that are equidistant and do not overlap.

    Attributes:
        size: rows of pixels per patch; also its columns, unless `width` is given.
        width: columns of pixels per patch, for a camera at an angle that sees the wall foreshortened.
        lags: largest lag on either side of zero; at most half of the patch.
    """

    size: int
    rows: int
    columns: int
    frame_shape: tuple[int, int]
    width: int | None = None
    lags: int = LAGS

    @property
    def lag_grid(self) -> LagGrid:
        """Lags of an estimate from these patches."""
        return lag_grid(self.lags)

    @property
    def count(self) -> int:
        return self.rows * self.columns

    @property
    def patch_shape(self) -> tuple[int, int]:
        """Pixels per patch (rows, columns)."""
        return self.size, self.width or self.size

    def lag_pitch_m(self, wavelength_m: float, distance_m: float, pixel_pitch_m: float) -> float:
        """Return the lag pitch on the object between rows, in metres: lambda z / (N pitch)."""
        return wavelength_m * distance_m / (self.size * pixel_pitch_m)

    def lag_pitches_m(self, wavelength_m: float, distance_m: float, pixel_pitch_m: tuple[float, float]) -> tuple[float, float]:
        """Return the distance on the object that corresponds to one lag (rows, columns), for pixel
        pitches foreshortened as seen from the object."""
        down, right = (n * pitch for n, pitch in zip(self.patch_shape, pixel_pitch_m, strict=True))
        return wavelength_m * distance_m / down, wavelength_m * distance_m / right

    def cut(self, frame: torch.Tensor) -> torch.Tensor:
        """Cut a frame (H, W) into patches, shape (count, *patch_shape)."""
        row_step, column_step = self.frame_shape[0] // self.rows, self.frame_shape[1] // self.columns
        height, width = self.patch_shape
        blocks = frame.unfold(0, height, row_step).unfold(1, width, column_step)
        return blocks[: self.rows, : self.columns].reshape(self.count, height, width)


def patch_grid(frame_shape: tuple[int, int], size: int | tuple[int, int], lags: int = LAGS) -> PatchGrid:
    """Return a grid of `size`-pixel patches for a frame; the number of patches along one axis is a multiple of that along
    the other.

    A 2056 x 2464 frame and 257 pixels give the 8 x 8 patches of Metzler et al. 2020. Raises InputError if no patch fits, or if a
    patch is too small for the lags.
    """
    height, width = (size, size) if isinstance(size, int) else size
    side = lag_grid(lags).side
    if not (side <= height <= frame_shape[0] and side <= width <= frame_shape[1]):
        shorter = min(frame_shape)
        raise InputError(
            "patch",
            f"a size between {side} pixels (as many lags) and the frame's shorter side ({shorter})",
            size,
            "choose another --patch or fewer lags",
        )
    rows, columns = frame_shape[0] // height, frame_shape[1] // width
    fewest = min(rows, columns)
    return PatchGrid(
        height, rows - rows % fewest, columns - columns % fewest, frame_shape, width if width != height else None, lags
    )


PITCH_M = 300e-6
"""Default lag pitch, that of Metzler et al. 2020."""

SQUARE_ENOUGH = 1.05
"""Maximum ratio of the two pixel pitches for square patches; the lag pitches then differ by at most this ratio."""


def automatic_patch_size(
    frame_shape: tuple[int, int],
    geometry: tuple[float, float, float | tuple[float, float]] | None = None,
    pitch_m: float = PITCH_M,
    lags: int = LAGS,
) -> int | tuple[int, int]:
    """Return the patch size whose lag pitch is closest to `pitch_m`, or an eighth of the frame if the geometry is unknown.

    The size lies between 2 `lags` + 1 pixels (all lags fit) and half of the shorter side (at least four patches). It is a number for square
    patches and (rows, columns) if the pixel pitches differ by more than `SQUARE_ENOUGH`.

    Args:
        geometry: (wavelength_m, distance_m, pixel_pitch_m), or None; a pair of pitches belongs to rows and columns.
    """

    def kept(wanted: int, side: int) -> int:
        least = lag_grid(lags).side
        return int(min(max(wanted, least), max(side // 2, min(least, side))))

    shorter = min(frame_shape)
    if geometry is None:
        return kept(shorter // 8, shorter)
    wavelength_m, distance_m, pixel_pitch_m = geometry
    pitches = pixel_pitch_m if isinstance(pixel_pitch_m, tuple) else (pixel_pitch_m, pixel_pitch_m)
    wanted = [round(wavelength_m * distance_m / (pitch_m * pitch)) for pitch in pitches]
    if max(pitches) <= SQUARE_ENOUGH * min(pitches):
        return kept(wanted[0], shorter)
    return kept(wanted[0], frame_shape[0]), kept(wanted[1], frame_shape[1])


def autocorrelate(albedo: np.ndarray) -> np.ndarray:
    """Return the linear autocorrelation r*r of a real image (n, n), float64 (2n - 1, 2n - 1), zero lag in the middle."""
    n = albedo.shape[0]
    spectrum = np.fft.rfft2(albedo.astype(np.float64), s=(2 * n, 2 * n))
    lags = np.fft.fftshift(np.fft.irfft2(np.abs(spectrum) ** 2, s=(2 * n, 2 * n)))
    return lags[1:, 1:]


def peak_of_cell_means(albedo_autocorrelation: np.ndarray) -> float:
    """Return (r*r)(0) of the albedo, from the autocorrelation of its cell means.

    Averaging over cells rounds off the cusp of r*r at zero lag. For edges along an axis, r*r falls by c per lag, and the means lose
    c / 3 at zero lag and nothing at a lag of one. Half of the difference between these two lags, added for each axis, restores
    the peak. The error is below 5 % for letters four cells thick, oblique edges included.
    """
    middle = albedo_autocorrelation.shape[0] // 2
    peak = albedo_autocorrelation[middle, middle]
    return float(2.0 * peak - 0.5 * (albedo_autocorrelation[middle, middle + 1] + albedo_autocorrelation[middle + 1, middle]))


def smooth_by_window(albedo_autocorrelation: np.ndarray, cells_per_lag: int = 1, lags: int | None = None) -> np.ndarray:
    """Convolve r*r with sinc^2 along each axis, which is the effect of a boxcar patch on the estimate, and sample it at
    whole lags.

    r*r of an image of square cells is bilinear between cell lags, so the convolution is exact.

    Args:
        albedo_autocorrelation: odd square array of lags one cell apart, zero lag in the middle.
        cells_per_lag: whole number of cells per lag.
        lags: largest lag of the result; by default as many as the input has.

    Returns:
        float64 (2 lags + 1, 2 lags + 1); zero beyond the lags of the input.
    """
    reach = lag_grid_of(albedo_autocorrelation).lags
    kernel = window_kernel((reach + 1) // cells_per_lag - 1 if lags is None else lags, reach, cells_per_lag)
    return kernel @ albedo_autocorrelation @ kernel.T


@lru_cache(maxsize=16)
def window_kernel(lags: int = LAGS, reach: int | None = None, cells_per_lag: int = 1) -> np.ndarray:
    """Return the matrix that converts r*r at the spacing of cells to lags along one axis: linear interpolation between
    cells, then convolution with sinc^2.

    Its shape is (2 lags + 1, 2 reach + 1); `reach`, the number of cells on either side of zero, is `lags` by default.
    """
    reach = lags if reach is None else reach
    fine = 64
    position = (np.arange(-fine, fine) + 0.5) / fine
    hat = (1.0 - np.abs(position)) / fine
    lag = lag_grid(lags).steps[:, None]
    cell = np.arange(-reach, reach + 1)[None, :] / cells_per_lag
    kernel = np.zeros((2 * lags + 1, 2 * reach + 1))
    for offset, weight in zip(position, hat, strict=True):
        kernel += weight * np.sinc(lag - cell - offset / cells_per_lag) ** 2
    return kernel / cells_per_lag
