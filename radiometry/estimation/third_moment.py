"""Third moment of filtered frames: what tells the speckle of an object from light that merely looks like it.

Speckle is the squared modulus of a circular Gaussian field, so the spectrum A of a frame has a third moment, the triple
correlation of the albedo r: E[A(a) A(b) A(-a-b)] = T(a, b) + T(-a, -b) (Lohmann, Weigelt and Wirnitzer,
doi:10.1364/AO.22.004028). Texture, gradients and fringes with the same power spectrum have none, or another. Here frames are
filtered to J = w A, w the share of signal at each lag, and the mean of J^3 is compared with that of a candidate,

    E[J^3] = 2 sum over x, y, z of r_x r_y r_z w(y - x) w(z - y) w(x - z) = 2 tr((D M)^3),   D = diag(r),  M_xy = w(x - y),

while E[J^2] is the sum over lags of w^2 (r*r). Shot noise adds its own part, which is subtracted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.fft import next_fast_len

from radiometry.autocorrelation import LAGS

_PADDED = 128
_BLOCKS = 8
"""Along each side of a frame, whose scatter gives the error."""

MOST_FRAMES = 8
"""Frames whose spectra are kept."""


@dataclass(frozen=True)
class NarrowSpectrum:
    """Spectrum of a padded frame at the frequencies of the lags.

    Attributes:
        values: complex64 (rows, columns), rows as `torch.fft` orders them, columns from zero.
        lag_rows, lag_columns: lag of each.
        padded: size of the padded frame. inside: share of it that the frame fills.
    """

    values: torch.Tensor
    lag_rows: np.ndarray
    lag_columns: np.ndarray
    padded: tuple[int, int]
    inside: tuple[float, float]


def narrow(spectrum: torch.Tensor, padded: tuple[int, int], frame: tuple[int, int], patch: tuple[int, int]) -> NarrowSpectrum:
    """Keep of a frame's spectrum (rows, columns // 2 + 1) what the lags hold."""
    rows, columns = (min(int((LAGS + 1) * side / size), side // 2 - 1) for side, size in zip(padded, patch, strict=True))
    values = torch.cat((spectrum[: rows + 1, : columns + 1], spectrum[-rows:, : columns + 1]))
    order = np.concatenate((np.arange(rows + 1), np.arange(-rows, 0)))
    return NarrowSpectrum(values.contiguous(), order * (patch[0] / padded[0]), np.arange(columns + 1) * (patch[1] / padded[1]),
                          padded, (frame[0] / padded[0], frame[1] / padded[1]))


@dataclass(frozen=True)
class FilteredFrames:
    """Frames as far as lags hold them: their spectra, mean level, and the pixels of a patch."""

    spectra: tuple[NarrowSpectrum, ...]
    level: float
    patch_pixels: int

    def likeness(self, albedo: np.ndarray, weight: np.ndarray, amplitude: np.ndarray, signal: np.ndarray, floor: float,
                 power: float) -> tuple[float, float]:
        """Third moment of the frames over that of speckle from an albedo (64, 64), and its standard error; 1 for speckle.

        Args:
            weight: w (127, 127). amplitude: of the camera's transfer, root of H (127, 127).
            signal, floor: of the estimate as measured. power: that the albedo's r*r is to be multiplied with.
        """
        measured, error = third_moment(self.spectra, weight)
        measured -= shot_noise_part(weight, signal, floor, self.level, self.patch_pixels)
        expected = expected_third_moment(albedo, weight * amplitude, power, self.patch_pixels)
        return (measured / expected, error / expected) if expected > 0.0 else (0.0, np.inf)


def third_moment(spectra: Sequence[NarrowSpectrum], weight: np.ndarray) -> tuple[float, float]:
    """Mean of J^3 over frames, in frame units cubed, and its standard error.

    Args:
        weight: w (127, 127), even, zero lag at [63, 63].
    """
    means = []
    for one in spectra:
        filtered = _filtered(one, weight)
        sides = [int(size * share) // _BLOCKS for size, share in zip(filtered.shape, one.inside, strict=True)]
        cube = filtered[: sides[0] * _BLOCKS, : sides[1] * _BLOCKS] ** 3
        means.append(cube.reshape(_BLOCKS, sides[0], _BLOCKS, sides[1]).double().mean((1, 3)).flatten())
    blocks = torch.cat(means)
    return float(blocks.mean()), float(blocks.std() / len(blocks) ** 0.5)


def _filtered(one: NarrowSpectrum, weight: np.ndarray) -> torch.Tensor:
    """J of one frame, sampled at three times its largest frequency: the cube then has no alias at zero."""
    reach = [int(np.abs(np.argwhere(weight)[:, axis] - LAGS).max()) + 1 for axis in (0, 1)]
    rows, columns = np.abs(one.lag_rows) < reach[0], one.lag_columns < reach[1]
    sides = [min(next_fast_len(int(3 * far / step) + 2, real=True), size) for far, step, size
             in zip(reach, (one.lag_rows[1], one.lag_columns[1]), one.padded, strict=True)]
    down, right = (torch.from_numpy(_between_lags(lags)) for lags in (one.lag_rows[rows], one.lag_columns[columns]))
    fine = (down @ torch.from_numpy(weight.astype(np.float32)) @ right.T).to(one.values.device)
    spectrum = torch.zeros((sides[0], sides[1] // 2 + 1), dtype=torch.complex64, device=one.values.device)
    values = one.values[torch.from_numpy(np.flatnonzero(rows)), : int(columns.sum())] * fine
    ahead = int((one.lag_rows[rows] >= 0.0).sum())
    spectrum[:ahead, : values.shape[1]] = values[:ahead]
    spectrum[sides[0] - len(values) + ahead :, : values.shape[1]] = values[ahead:]
    return torch.fft.irfft2(spectrum, s=sides) * (sides[0] * sides[1] / (one.padded[0] * one.padded[1]))


def shot_noise_part(weight: np.ndarray, signal: np.ndarray, floor: float, level: float, patch_pixels: int) -> float:
    """What shot noise adds to the mean of J^3, in frame units cubed.

    Args:
        weight: w (127, 127). signal, floor: of the estimate, signal (127, 127). level: mean of the frames.
        patch_pixels: pixels of a patch.
    """
    padded = np.zeros((2 * _PADDED, 2 * _PADDED))
    padded[: 2 * LAGS + 1, : 2 * LAGS + 1] = weight
    pairs = np.fft.fftshift(np.fft.ifft2(np.abs(np.fft.fft2(padded)) ** 2).real)
    around = pairs[_PADDED - LAGS : _PADDED + LAGS + 1, _PADDED - LAGS : _PADDED + LAGS + 1]
    gain = floor / level if level > 0.0 else 0.0
    return float(gain * (weight * around * (3.0 * signal + floor)).sum()) / patch_pixels**2


def expected_third_moment(albedo: np.ndarray, weight: np.ndarray, power: float, patch_pixels: int) -> float:
    """E[J^3] of speckle from an albedo (64, 64) whose r*r is the albedo's own times `power`."""
    cells = np.argwhere(albedo > 0.02 * albedo.max())
    shown = torch.from_numpy(albedo[tuple(cells.T)].astype(np.float32)).sqrt()
    apart = cells[:, None] - cells[None] + LAGS
    matrix = shown[:, None] * torch.from_numpy(weight.astype(np.float32)[apart[..., 0], apart[..., 1]]) * shown
    return 2.0 * float((power / patch_pixels) ** 1.5 * ((matrix @ matrix) * matrix).sum(dtype=torch.float64))


def _between_lags(lags: np.ndarray) -> np.ndarray:
    """Weights (frequencies, 127) of linear interpolation between lags; zero beyond the last."""
    return np.clip(1.0 - np.abs(lags[:, None] - np.arange(-LAGS, LAGS + 1)), 0.0, None).astype(np.float32)
