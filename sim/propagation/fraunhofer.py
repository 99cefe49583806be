"""Fraunhofer propagation: the field on the wall is the Fourier transform of the field on the object.

Goodman, Introduction to Fourier Optics, Eq. 4-25; the paper's Eq. (6). The phase common to all of
the object (the carrier, and the wall's quadratic phase) drops out of the intensity and is left out.
The object's own quadratic phase is dropped too. For a delta-correlated random phase on the object
that changes the realisation, not its statistics, which is why the kernel is legal in `statistical`
accuracy only. Cost: one FFT of the frame, rows without object skipped.
"""

from __future__ import annotations

import math

import torch

from sim.propagation.option import Option, Task, Terms
from sim.propagation.sampling import Scatterers, Wall, middle
from sim.propagation.validity import UNCORRELATED_FIELD_ERROR

FFT_SECONDS_PER_PIXEL = 2e-8


def propagate(scatterers: Scatterers, wall: Wall, terms: Terms) -> torch.Tensor:
    """Field on the wall, complex64 (H, W), unitary over the lattice's period."""
    lattice = scatterers.lattice
    return middle(far_field(torch.from_numpy(lattice.grid(scatterers.amplitude)).to(terms.device), lattice.period), wall.shape)


def predict(task: Task) -> list[Option]:
    if "float32" not in task.precisions:
        return []
    pixels = math.prod(task.wall.shape)
    error = task.statistical_error if task.accuracy == "statistical" else UNCORRELATED_FIELD_ERROR
    return [
        Option(
            "fraunhofer",
            "float32",
            error,
            FFT_SECONDS_PER_PIXEL * pixels,
            16 * pixels,
            "flat, delta-correlated object in the far field",
        )
    ]


def far_field(field: torch.Tensor, period: tuple[int, int]) -> torch.Tensor:
    """Field on the wall from the field on the object.

    Args:
        field: complex (rows, columns), sampled at `Geometry.object_pitch_m`, centred on the object;
            not larger than the period.
        period: pixels (H, W) after which the field repeats.

    Returns:
        complex (H, W), unitary: the mean of |wall|^2 is the sum of |field|^2 over the samples.
    """
    # Where the object sits on the grid only tilts the phase of the wall's field.
    columns = torch.fft.fft(field, n=period[1], dim=1)
    return torch.fft.fft(columns, n=period[0], dim=0)
