"""H: what the camera's pupil and pixel do to the speckle power spectrum, as a function of lag."""

from __future__ import annotations

import numpy as np


def pupil_otf(frequency_per_m: np.ndarray, pupil_diameter_m: float, wavelength_m: float,
              pupil_distance_m: float) -> np.ndarray:
    """Incoherent transfer function of a circular pupil, at spatial frequencies on the wall.

    Goodman, Introduction to Fourier Optics, Eq. 6-32: cut-off D / (lambda z), any shape of input.
    """
    reduced = np.clip(np.abs(frequency_per_m) * wavelength_m * pupil_distance_m / pupil_diameter_m, 0.0, 1.0)
    return 2.0 / np.pi * (np.arccos(reduced) - reduced * np.sqrt(1.0 - reduced**2))


def amplitude_transfer(frequency_row_per_m: np.ndarray, frequency_column_per_m: np.ndarray, pixel_pitch_m: float,
                       pupil_diameter_m: float, wavelength_m: float, pupil_distance_m: float) -> np.ndarray:
    """Transfer function of the mean image: pupil OTF times the square pixel's sinc (100 % fill)."""
    pixel = np.sinc(frequency_row_per_m * pixel_pitch_m) * np.sinc(frequency_column_per_m * pixel_pitch_m)
    radius = np.hypot(frequency_row_per_m, frequency_column_per_m)
    return pixel * pupil_otf(radius, pupil_diameter_m, wavelength_m, pupil_distance_m)


def lag_transfer(lags: np.ndarray, pitch_m: float, distance_m: float, pixel_pitch_m: float, pupil_diameter_m: float,
                 wavelength_m: float, pupil_distance_m: float) -> np.ndarray:
    """H of the noise model S = H (r*r) + b, on a square grid of lags.

    A lag L on the object is the spatial frequency L / (lambda z) on the wall; H is the square of
    `amplitude_transfer` there, because the autocorrelation estimate is a power spectrum.

    Args:
        lags: integer lags of one axis, shape (n,).

    Returns:
        shape (n, n), 1 at zero lag.
    """
    frequency = lags * pitch_m / (wavelength_m * distance_m)
    return amplitude_transfer(frequency[:, None], frequency[None, :], pixel_pitch_m, pupil_diameter_m, wavelength_m,
                              pupil_distance_m) ** 2
