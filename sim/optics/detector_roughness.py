"""Roughness of the virtual detector seen through the camera pupil: subjective speckle multiplied with the objective one.

Exact method: on a finer grid, each cell of the field is multiplied by a circular complex Gaussian number, because a cell
contains many independent heights; the pupil filters the field, and the intensity is summed over each pixel. Faster method:
this sum is sampled independently for each pixel from a Gamma distribution with M degrees of freedom (Goodman, Speckle
Phenomena in Optics, section 4.6); M follows from pupil and pixel. The mean of both is the incoherent blur of
`camera.mean_image`. The wall keeps polarisation, so that its heights multiply both polarisations by one factor.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from radiometry.transfer import subjective_modes
from sim.geometry import Geometry


def oversampling(geometry: Geometry) -> int:
    """Return the cells per pixel and axis that resolve the subjective speckle; odd, so that one cell lies at the centre
    of a pixel."""
    cutoff = geometry.camera.pupil_diameter_m / (geometry.wavelength_m * geometry.camera.pupil_distance_m)
    return math.ceil(2.0 * geometry.camera.pixel_pitch_m * cutoff) | 1


def exact_image(field: torch.Tensor, factor: int, geometry: Geometry, rng: np.random.Generator) -> torch.Tensor:
    """Return the intensity collected by each pixel, (H, W); its mean over the phases of the wall is the blurred |field|^2.

    Args:
        field: complex (factor H, factor W) on the wall.
        factor: from `oversampling`.
    """
    height, width = field.shape
    pitch = geometry.camera.pixel_pitch_m / factor
    parts = rng.standard_normal((2, *field.shape), np.float32) * np.float32(math.sqrt(0.5))
    spectrum = torch.fft.fft2(field * torch.complex(*(torch.from_numpy(part).to(field.device) for part in parts)))
    row, column = (torch.fft.fftfreq(n, pitch, device=field.device) for n in (height, width))
    inside = torch.hypot(row[:, None], column[None]) <= 0.5 * geometry.camera.pupil_diameter_m / (
        geometry.wavelength_m * geometry.camera.pupil_distance_m
    )
    image = torch.fft.ifft2(spectrum * inside)
    intensity = image.real.square() + image.imag.square()
    half_column = torch.fft.rfftfreq(width, pitch, device=field.device)
    pixel = torch.sinc(row * geometry.camera.pixel_pitch_m)[:, None] * torch.sinc(half_column * geometry.camera.pixel_pitch_m)
    collected = torch.fft.irfft2(torch.fft.rfft2(intensity) * pixel, s=(height, width))
    middle = factor // 2
    return collected[middle::factor, middle::factor].clamp_min(0.0) * (inside.numel() / inside.sum())


def gamma_image(mean: torch.Tensor, geometry: Geometry, rng: np.random.Generator) -> torch.Tensor:
    """Multiply a mean image (H, W) by independent Gamma factors of mean 1 and M degrees of freedom."""
    optics = (
        geometry.camera.pixel_pitch_m,
        geometry.camera.pupil_diameter_m,
        geometry.wavelength_m,
        geometry.camera.pupil_distance_m,
    )
    dof = subjective_modes(*optics)
    factor = rng.standard_gamma(dof, mean.shape, np.float32) / np.float32(dof)
    return mean * torch.from_numpy(factor).to(mean.device)
