"""Camera: from the intensity on the virtual detector to recorded electrons, by pupil, pixel, photons and electronics."""

from __future__ import annotations

import numpy as np
import torch

from radiometry.transfer import amplitude_transfer
from sim.geometry import Geometry
from sim.plugins.speckle_camera import Electronics


def transfer_function(geometry: Geometry) -> torch.Tensor:
    """Return pupil OTF times pixel sinc at the frequencies of an rfft2 of the canvas, float32 (H, W // 2 + 1).

    The wall is rough, so the mean image is the intensity on the wall, blurred incoherently by the pupil.
    """
    height, width = geometry.canvas_shape
    transfer = amplitude_transfer(
        np.fft.fftfreq(height, geometry.pixel_pitch_m)[:, None],
        np.fft.rfftfreq(width, geometry.pixel_pitch_m)[None, :],
        geometry.pixel_pitch_m,
        geometry.pupil_diameter_m,
        geometry.wavelength_m,
        geometry.pupil_distance_m,
    )
    return torch.from_numpy(transfer.astype(np.float32))


def mean_image(wall_intensity: torch.Tensor, transfer: torch.Tensor) -> torch.Tensor:
    """Return the intensity that pixels collect: blurred by pupil and pixel, never negative."""
    spectrum = torch.fft.rfft2(wall_intensity) * transfer
    return torch.fft.irfft2(spectrum, s=wall_intensity.shape).clamp_min_(0.0)


CAMERA = 20200107
"""Seed of the fixed pattern, which all frames of a camera share."""


def expose(
    photoelectrons: np.ndarray, electronics: Electronics, rng: np.random.Generator, shot_noise: bool = True
) -> np.ndarray:
    """Sample one recorded frame from expected photoelectrons, float32, in electrons.

    Shot noise of signal and dark current, or, for a photon-counting camera, the number of gates with a photon, then read,
    row, column and fixed-pattern noise, full well and ADC. An effect with parameter 0 is omitted.
    """
    mean = photoelectrons + electronics.dark_current * electronics.exposure_s
    if electronics.gate:
        stored = count_photons(mean, electronics.gates, rng if shot_noise else None)
    else:
        stored = (rng.poisson(mean) if shot_noise else mean).astype(np.float32)
    if electronics.read_noise:
        stored += np.float32(electronics.read_noise) * rng.standard_normal(stored.shape, np.float32)
    if electronics.row_noise:
        stored += np.float32(electronics.row_noise) * rng.standard_normal((stored.shape[0], 1), np.float32)
    if electronics.column_noise:
        stored += np.float32(electronics.column_noise) * rng.standard_normal((1, stored.shape[1]), np.float32)
    if electronics.fixed_pattern:
        pattern = np.random.default_rng(CAMERA).standard_normal(stored.shape, np.float32)
        stored += np.float32(electronics.fixed_pattern) * pattern
    if electronics.full_well:
        # An ADC with offset keeps read noise below zero; only the top is clipped.
        np.minimum(stored, np.float32(electronics.full_well), out=stored)
    if electronics.bits:
        step = np.float32(electronics.step)
        stored = np.minimum(np.round(stored / step), np.float32(2**electronics.bits - 1)) * step
    return stored


def count_photons(mean: np.ndarray, gates: float, rng: np.random.Generator | None) -> np.ndarray:
    """Return the gates in which a pixel detects at least one photon, float32; their expectation without a random generator.

    A gate detects none with probability exp(-mean / gates), so counts are binomial and saturate at the number of gates.
    """
    detected = -np.expm1(-mean / gates)
    counts = gates * detected if rng is None else rng.binomial(int(gates), detected)
    return counts.astype(np.float32)
