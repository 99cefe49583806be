"""Camera optics: from the intensity on the virtual detector to the intensity that pixels collect."""

from __future__ import annotations

import numpy as np
import torch

from radiometry.transfer import amplitude_transfer
from sim.geometry import Geometry


def transfer_function(geometry: Geometry) -> torch.Tensor:
    """Return pupil OTF times pixel sinc at the frequencies of an rfft2 of the canvas, float32 (H, W // 2 + 1).

    The wall is rough, so the mean image is the intensity on the wall, blurred incoherently by the pupil.
    """
    height, width = geometry.canvas_shape
    transfer = amplitude_transfer(
        np.fft.fftfreq(height, geometry.camera.pixel_pitch_m)[:, None],
        np.fft.rfftfreq(width, geometry.camera.pixel_pitch_m)[None, :],
        geometry.camera.pixel_pitch_m,
        geometry.camera.pupil_diameter_m,
        geometry.wavelength_m,
        geometry.camera.pupil_distance_m,
    )
    return torch.from_numpy(transfer.astype(np.float32))


def mean_image(wall_intensity: torch.Tensor, transfer: torch.Tensor) -> torch.Tensor:
    """Return the intensity that pixels collect: blurred by pupil and pixel, never negative."""
    spectrum = torch.fft.rfft2(wall_intensity) * transfer
    return torch.fft.irfft2(spectrum, s=wall_intensity.shape).clamp_min_(0.0)
