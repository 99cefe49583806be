"""Fresnel propagation: the exact phase of each sample at the frame's centre, then one FFT.

Approximation: the path difference changes from pixel to pixel in proportion to the sample's offset across the line of
sight, and amplitudes are constant (Goodman, Introduction to Fourier Optics, Eq. 4-17). Depth enters only the phase at the frame's
centre; the directions neglect it. Valid where the remaining phase error is small; `validity.py` predicts the error. Cost: one FFT
of the frame, rows without object skipped.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from sim.propagation.fraunhofer import FFT_SECONDS_PER_PIXEL
from sim.propagation.option import Option, Task, Terms
from sim.propagation.sampling import Scatterers, Wall, path_difference, phasor
from sim.propagation.validity import fresnel_error


def propagate(scatterers: Scatterers, wall: Wall, terms: Terms) -> torch.Tensor:
    """Return the field on the wall, complex64 (H, W)."""
    lattice = scatterers.lattice
    field = np.zeros(lattice.shape, np.complex128)
    field[lattice.place] = scatterers.amplitude * phasor(
        path_difference(wall.centre_m, scatterers.position_m), wall.wavelength_m
    )
    # Both grids are centred between samples: exp(-2 pi i (m - c_m)(j - c_j) / M) per axis, as FFT and tilts.
    for axis, (samples, pixels, repeat) in enumerate(zip(lattice.shape, wall.shape, lattice.period, strict=True)):
        tilt = phasor(0.5 * (pixels - 1) * np.arange(samples) / repeat, 1.0)
        field = field * (tilt[:, None] if axis == 0 else tilt)
    spectrum = torch.from_numpy(field.astype(np.complex64)).to(terms.device)
    rows, columns = lattice.period
    spectrum = torch.fft.fft(torch.fft.fft(spectrum, n=columns, dim=1)[:, : wall.shape[1]], n=rows, dim=0)
    spectrum = spectrum[: wall.shape[0]]
    for axis, (samples, pixels, repeat) in enumerate(zip(lattice.shape, wall.shape, lattice.period, strict=True)):
        tilt = torch.from_numpy(phasor(0.5 * (samples - 1) * (np.arange(pixels) - 0.5 * (pixels - 1)) / repeat, 1.0))
        spectrum *= (tilt[:, None] if axis == 0 else tilt).to(spectrum)
    return spectrum


def predict(task: Task) -> list[Option]:
    if "float32" not in task.precisions:
        return []
    pixels = math.prod(task.wall.shape)
    error = task.statistical_error if task.accuracy == "statistical" else fresnel_error(task.wall, task.place, task.scatterers)
    return [
        Option(
            "fresnel", "float32", error, 1.5 * FFT_SECONDS_PER_PIXEL * pixels, 16 * pixels, "exact phases at the frame's centre"
        )
    ]
