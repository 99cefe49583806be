"""H: what the camera's pupil and pixel do to the speckle power spectrum, as a function of lag."""

from __future__ import annotations

import numpy as np


def pupil_otf(frequency_per_m: np.ndarray, pupil_diameter_m: float, wavelength_m: float, pupil_distance_m: float) -> np.ndarray:
    """Incoherent transfer function of a circular pupil, at spatial frequencies on the wall.

    Goodman, Introduction to Fourier Optics, Eq. 6-32: cut-off D / (lambda z), any shape of input.
    """
    reduced = np.clip(np.abs(frequency_per_m) * wavelength_m * pupil_distance_m / pupil_diameter_m, 0.0, 1.0)
    return 2.0 / np.pi * (np.arccos(reduced) - reduced * np.sqrt(1.0 - reduced**2))


def amplitude_transfer(
    frequency_row_per_m: np.ndarray,
    frequency_column_per_m: np.ndarray,
    pixel_pitch_m: float,
    pupil_diameter_m: float,
    wavelength_m: float,
    pupil_distance_m: float,
) -> np.ndarray:
    """Transfer function of the mean image: pupil OTF times the square pixel's sinc (100 % fill)."""
    pixel = np.sinc(frequency_row_per_m * pixel_pitch_m) * np.sinc(frequency_column_per_m * pixel_pitch_m)
    radius = np.hypot(frequency_row_per_m, frequency_column_per_m)
    return pixel * pupil_otf(radius, pupil_diameter_m, wavelength_m, pupil_distance_m)


def subjective_modes(
    pixel_pitch_m: float, pupil_diameter_m: float, wavelength_m: float, pupil_distance_m: float, samples: int = 512
) -> float:
    """Return M, one over the relative variance of the subjective speckle of a rough wall that a pixel collects through the pupil
    (Goodman, Speckle Phenomena in Optics, section 4.6).
    """
    cutoff = pupil_diameter_m / (wavelength_m * pupil_distance_m)
    frequency = (np.arange(samples) + 0.5) / samples * cutoff
    radius = np.hypot(frequency[:, None], frequency[None])
    otf = pupil_otf(radius, pupil_diameter_m, wavelength_m, pupil_distance_m)
    pixel = np.sinc(frequency * pixel_pitch_m) ** 2
    return float(otf.sum() / (otf * pixel[:, None] * pixel[None]).sum())


def lag_transfer(
    lags: np.ndarray,
    patch_shape: tuple[int, int],
    pixel_pitch_m: float,
    pupil_diameter_m: float,
    wavelength_m: float,
    pupil_distance_m: float,
) -> np.ndarray:
    """H of the noise model S = H (r*r) + b, on a square grid of lags.

    Lag k of a patch of N pixels is the frequency k / N in cycles per pixel, at any angle between camera and wall; H is
    the square of `amplitude_transfer` there, because the autocorrelation estimate is a power spectrum.

    Args:
        lags: integer lags of one axis, shape (n,).
        patch_shape: pixels of a patch (rows, columns).
        pixel_pitch_m: pixel pitch on the virtual detector, as if it faced the camera.

    Returns:
        shape (n, n), 1 at zero lag.
    """
    row, column = (lags / (pixels * pixel_pitch_m) for pixels in patch_shape)
    return (
        amplitude_transfer(row[:, None], column[None, :], pixel_pitch_m, pupil_diameter_m, wavelength_m, pupil_distance_m) ** 2
    )


def gaussian_transfer(lags: np.ndarray, patch_shape: tuple[int, int], blur_pixels: tuple[float, float]) -> np.ndarray:
    """H of a Gaussian blur of standard deviations (down, right) in pixels, shape (n, n) for lags (n,); see `lag_transfer`."""
    row, column = (lags * (2.0 * np.pi * blur / pixels) for blur, pixels in zip(blur_pixels, patch_shape, strict=True))
    return np.exp(-(row[:, None] ** 2) - column[None, :] ** 2)
