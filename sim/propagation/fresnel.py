"""Fresnel propagation: the exact phase of each sample at the frame's centre, then one FFT.

Approximation: the path difference changes from pixel to pixel in proportion to the sample's offset across the line of
sight, and amplitudes are constant (Goodman, Introduction to Fourier Optics, Eq. 4-17). Depth enters the phase at the
frame's centre, not the directions. Valid where what is left is small; `validity.py` predicts the error. Cost: one FFT
of the frame, rows without object skipped.
"""

from __future__ import annotations

import numpy as np
import torch

from sim.propagation.sampling import Scatterers, Wall, path_difference, phasor


def fresnel(scatterers: Scatterers, grid: tuple[np.ndarray, np.ndarray], grid_shape: tuple[int, int], wall: Wall,
            period: tuple[int, int] | None = None, device: str = "cpu") -> torch.Tensor:
    """Field on the wall, complex64 (H, W).

    Args:
        grid: row and column of each scatterer (n,) on the object grid whose pitch is lambda d / (period x pixel pitch).
        grid_shape: (rows, columns) of that grid, centred on the object.
        period: pixels after which the field repeats, the wall's own where None.
    """
    field = np.zeros(grid_shape, np.complex128)
    field[grid] = scatterers.amplitude * phasor(path_difference(wall.centre_m, scatterers.position_m), wall.wavelength_m)
    period = period or wall.shape
    # Both grids are centred between samples: exp(-2 pi i (m - c_m)(j - c_j) / M) per axis, as FFT and tilts.
    for axis, (samples, pixels, repeat) in enumerate(zip(grid_shape, wall.shape, period, strict=True)):
        tilt = phasor(0.5 * (pixels - 1) * np.arange(samples) / repeat, 1.0)
        field = field * (tilt[:, None] if axis == 0 else tilt)
    spectrum = torch.from_numpy(field.astype(np.complex64)).to(device)
    spectrum = torch.fft.fft(torch.fft.fft(spectrum, n=period[1], dim=1)[:, : wall.shape[1]], n=period[0], dim=0)
    spectrum = spectrum[: wall.shape[0]]
    for axis, (samples, pixels, repeat) in enumerate(zip(grid_shape, wall.shape, period, strict=True)):
        tilt = torch.from_numpy(phasor(0.5 * (samples - 1) * (np.arange(pixels) - 0.5 * (pixels - 1)) / repeat, 1.0))
        spectrum *= (tilt[:, None] if axis == 0 else tilt).to(spectrum)
    return spectrum
