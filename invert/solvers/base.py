"""Common parts of the phase retrieval methods: projections, residual, support, random starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

Progress = Callable[..., object]
"""Called with the number of steps done since the last call; 1 if it is left out."""


def no_progress(steps: int = 1) -> None:
    """Ignore progress."""


@dataclass(frozen=True)
class Candidates:
    """Images of all starts, (..., starts, n, n), and their residuals (..., starts).

    The residual is the relative squared error of the Fourier modulus; it is independent of a truth.
    """

    images: torch.Tensor
    residual: torch.Tensor


def to_modulus(image: torch.Tensor, modulus: torch.Tensor) -> torch.Tensor:
    """Project images (..., n, n) onto a Fourier modulus (..., n, n // 2 + 1).

    A frequency that is exactly zero has no phase and stays zero.
    """
    spectrum = torch.fft.rfft2(image)
    # modulus / |spectrum|, several times faster than through a complex absolute value
    scale = spectrum.real.square().add_(spectrum.imag.square()).clamp_min_(1e-38).rsqrt_().mul_(modulus)
    return torch.fft.irfft2(spectrum.mul_(scale), s=image.shape[-2:])


def modulus_residual(image: torch.Tensor, modulus: torch.Tensor) -> torch.Tensor:
    """Return the relative squared error of the Fourier modulus of each image of a batch."""
    error = (torch.fft.rfft2(image).abs() - modulus).square().sum((-2, -1))
    return error / modulus.square().sum((-2, -1)).clamp_min(1e-30)


def gaussian_blur(image: torch.Tensor, deviation: float) -> torch.Tensor:
    """Apply a periodic Gaussian blur, standard deviation in pixels."""
    side = image.shape[-1]
    row = torch.fft.fftfreq(side, device=image.device)[:, None]
    column = torch.fft.rfftfreq(side, device=image.device)
    transfer = torch.exp(-2.0 * (torch.pi * deviation) ** 2 * (row.square() + column.square()))
    return torch.fft.irfft2(torch.fft.rfft2(image) * transfer, s=image.shape[-2:])


def box_support(modulus: torch.Tensor, box: int) -> torch.Tensor:
    """Return a mask, 1 in a square of `box` pixels at the corner of the grid, 0 elsewhere, (n, n)."""
    side = modulus.shape[-2]
    support = torch.zeros(side, side, device=modulus.device)
    support[:box, :box] = 1.0
    return support


def random_starts(modulus: torch.Tensor, support: torch.Tensor, starts: int, rng: torch.Generator) -> torch.Tensor:
    """Return uniform random images inside the support, (..., starts, n, n), equal for every image of a batch, so that a
    result does not depend on the rest of the batch."""
    side = modulus.shape[-2]
    images = torch.rand(starts, side, side, generator=rng, device=modulus.device) * support
    return images.expand(*modulus.shape[:-2], starts, side, side).clone()
