"""Forward model of a frame: expected counts I = v H |F E|^2 + background, and the likelihood of counts.

F is the Fourier transform to the wall, H the transfer of pupil, pixel and blur, v the relative illumination; |F E|^2 is summed over one
or two polarisation modes. Counts are Poisson variables; read noise is included by shifting counts and background by its variance (shifted
Poisson). The subjective speckle of a rough wall multiplies the light by Gamma variables, which makes counts negative binomial.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.field.counts import FrameCounts
from invert.field.grid import FieldGrid

MIN_EXPECTED = 1e-2
"""Minimum expected counts of a pixel; a smaller expectation would give single photons any weight."""


@dataclass(frozen=True)
class ForwardModel:
    """Expected counts of a field on the object (modes, box rows, box columns).

    Attributes:
        transfer: H at the frequencies of an rfft2 of the periodic grid.
    """

    grid: FieldGrid
    transfer: torch.Tensor

    def blur(self, image: torch.Tensor) -> torch.Tensor:
        """Apply H to an image on the periodic grid; H is real and even, so it is its own adjoint."""
        return torch.fft.irfft2(torch.fft.rfft2(image) * self.transfer, s=self.grid.shape)

    def intensity(self, wall: torch.Tensor) -> torch.Tensor:
        """Return H |U|^2 on the frame."""
        return self.grid.on_frame(self.blur(power(wall).sum(0)))

    def gradient(self, residual: torch.Tensor, wall: torch.Tensor) -> torch.Tensor:
        """Return the derivative of sum(residual I) with respect to the conjugate of the field on the object."""
        padded = residual.new_zeros(self.grid.shape)
        self.grid.on_frame(padded).copy_(residual)
        return self.grid.to_object(wall * self.blur(padded))


def expected_counts(intensity: torch.Tensor, counts: FrameCounts) -> torch.Tensor:
    """Return the expected counts of an intensity on the frame."""
    return (counts.illumination * intensity + counts.background).clamp_min(MIN_EXPECTED)


def power(field: torch.Tensor) -> torch.Tensor:
    """Return |E|^2, without the square root of a complex absolute value."""
    return field.real.square().addcmul_(field.imag, field.imag)


def log_likelihood(counts: torch.Tensor, expected: torch.Tensor, roughness: float) -> torch.Tensor:
    """Return the log-likelihood of each pixel without terms that do not depend on the expectation: negative binomial with the
    variance I + roughness I^2, or Poisson for a roughness of zero.
    """
    found = counts * expected.log()
    if roughness == 0.0:
        return found - expected
    return found - (counts + 1.0 / roughness) * torch.log1p(roughness * expected)
