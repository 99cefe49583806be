"""Fraunhofer propagation: the field on the wall is the Fourier transform of the field on the object.

Goodman, Introduction to Fourier Optics, Eq. 4-25; Metzler et al. 2020, Eq. (6). The phase common to the whole object (the carrier,
and the quadratic phase of the wall) cancels in the intensity and is omitted. The quadratic phase of the object is omitted as
well. For a delta-correlated random phase on the object that changes the realisation but not its statistics, so the propagator is
allowed in `statistical` accuracy only. Cost: one FFT of the frame, without rows that are empty.
"""

from __future__ import annotations

import math

import torch

from sim.propagation.option import Option, Task, Terms
from sim.propagation.sampling import Scatterers, Wall, middle
from sim.propagation.validity import UNCORRELATED_FIELD_ERROR

FFT_SECONDS_PER_PIXEL = 2e-8


def propagate(scatterers: Scatterers, wall: Wall, terms: Terms) -> torch.Tensor:
    """Return the field on the wall, complex64 (H, W), normalised so that |E|^2 averages to the summed power of the
    scatterers over one period of the grid.
    """
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
    """Return the field on the wall from the field on the object.

    Args:
        field: complex (rows, columns), sampled at `Geometry.object_pitch_m`, centred on the object; not larger than the period.
        period: pixels (H, W) after which the field repeats.

    Returns:
        complex (H, W), unitary: the mean of |wall|^2 is the sum of |field|^2 over the samples.
    """
    # The position of the object on the grid only tilts the phase of the field on the wall.
    columns = torch.fft.fft(field, n=period[1], dim=1)
    return torch.fft.fft(columns, n=period[0], dim=0)
