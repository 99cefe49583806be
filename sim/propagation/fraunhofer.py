"""Fraunhofer propagation: the field on the wall is the Fourier transform of the field on the object.

Goodman, Introduction to Fourier Optics, Eq. 4-25; the paper's Eq. (6). The phase common to all of
the object (the carrier, and the wall's quadratic phase) drops out of the intensity and is left out.
The object's own quadratic phase is dropped too. For a delta-correlated random phase on the object
that changes the realisation, not its statistics, which is why the kernel is legal in `statistical`
accuracy only. Cost: one FFT of the frame, rows without object skipped.
"""

from __future__ import annotations

import torch


def fraunhofer(field: torch.Tensor, period: tuple[int, int]) -> torch.Tensor:
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
