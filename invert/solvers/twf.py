"""Truncated Wirtinger flow: gradient descent on the Poisson likelihood of the intensities, without outliers.

Chen and Candes, Communications on Pure and Applied Mathematics 70, 822 (2017), doi:10.1002/cpa.21638, algorithm 1
with its published constants. The starts are random, because the spectral start assumes Gaussian measurements.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from invert.solvers.base import Candidates, Progress, box_support, modulus_residual, no_progress, random_starts


@dataclass(frozen=True)
class TwfOptions:
    """`lower`, `upper`: limits of |a z| / |z|; `spread`: limit of the intensity error in multiples of the typical error;
    `step`: step size.
    """

    iterations: int = 1000
    starts: int = 16
    step: float = 0.2
    lower: float = 0.3
    upper: float = 5.0
    spread: float = 5.0


def poisson_gradient(spectrum: torch.Tensor, intensity: torch.Tensor, kept: torch.Tensor) -> torch.Tensor:
    """Return the gradient of mean(|a z|^2 - y log |a z|^2) over the kept measurements with respect to a real image z.

    Args:
        spectrum: full Fourier transform a z, (..., n, n); intensity y and mask of the same shape.
    """
    power = spectrum.real.square() + spectrum.imag.square()
    weighted = spectrum * ((1.0 - intensity / power.clamp_min(1e-30)) * kept)
    return 2.0 * torch.fft.ifft2(weighted).real


def full_intensity(modulus: torch.Tensor) -> torch.Tensor:
    """|F|^2 on the whole Fourier plane, (..., 1, n, n), from the half plane of a real image."""
    side = modulus.shape[-2]
    tail = torch.roll(modulus.flip(-2), 1, -2)[..., 1 : side - modulus.shape[-1] + 1].flip(-1)
    return torch.cat((modulus, tail), -1).square().unsqueeze(-3)


def start_at_scale(modulus: torch.Tensor, support: torch.Tensor, starts: int, rng: torch.Generator) -> torch.Tensor:
    """Return random starts whose energy is the mean intensity of the measurements."""
    image = random_starts(modulus, support, starts, rng)
    energy = full_intensity(modulus).mean((-2, -1), keepdim=True)
    return image * (energy / image.square().sum((-2, -1), keepdim=True).clamp_min(1e-30)).sqrt()


def within(magnitude: torch.Tensor, norm: torch.Tensor, lower: float, upper: float) -> torch.Tensor:
    """First truncation rule: |a z| between `lower` and `upper` times |z|."""
    return (magnitude >= lower * norm) & (magnitude <= upper * norm)


def truncated_flow(
    modulus: torch.Tensor,
    box: int,
    rng: torch.Generator,
    options: TwfOptions,
    typical: Callable[[torch.Tensor], torch.Tensor],
    progress: Progress,
) -> Candidates:
    """Descend the Poisson likelihood over measurements that satisfy both truncation rules.

    Args:
        typical: typical intensity error of each image, (..., n, n) to (..., 1, 1); `options.spread` multiplies it.
    """
    support, intensity = box_support(modulus, box), full_intensity(modulus)
    image = start_at_scale(modulus, support, options.starts, rng)
    for _ in range(options.iterations):
        spectrum = torch.fft.fft2(image)
        magnitude = spectrum.abs()
        norm = image.square().sum((-2, -1), keepdim=True).sqrt().clamp_min(1e-30)
        error = (intensity - magnitude.square()).abs()
        near = error <= options.spread * typical(error) * magnitude / norm
        kept = within(magnitude, norm, options.lower, options.upper) & near
        image = image - options.step * poisson_gradient(spectrum, intensity, kept) * support
        progress()
    return Candidates(image, modulus_residual(image, modulus.unsqueeze(-3)))


def twf(
    modulus: torch.Tensor, box: int, rng: torch.Generator, options: TwfOptions | None = None, progress: Progress = no_progress
) -> Candidates:
    """Retrieve real images of either sign; arguments as in `hio`. The typical error is the mean."""
    return truncated_flow(
        modulus, box, rng, options or TwfOptions(), lambda error: error.mean((-2, -1), keepdim=True), progress
    )
