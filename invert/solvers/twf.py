"""Truncated Wirtinger flow: gradient descent on the Poisson likelihood of the intensities, without outliers.

Chen and Candes, Communications on Pure and Applied Mathematics 70, 822 (2017), doi:10.1002/cpa.21638, algorithm 1
with its published constants. The starts are random, because the spectral start assumes Gaussian measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.solvers.base import Images, PhaseProblem, Solver


def poisson_gradient(spectrum: torch.Tensor, intensity: torch.Tensor, kept: torch.Tensor) -> torch.Tensor:
    """Return the gradient of mean(|a z|^2 - y log |a z|^2) over the kept measurements with respect to a real image z.

    Args:
        spectrum: full Fourier transform a z, (..., n, n); intensity y and mask of the same shape.
    """
    power = spectrum.real.square() + spectrum.imag.square()
    weighted = spectrum * ((1.0 - intensity / power.clamp_min(1e-30)) * kept)
    return 2.0 * torch.fft.ifft2(weighted).real


def start_at_scale(problem: PhaseProblem, starts: int, rng: torch.Generator) -> Images:
    """Return random starts whose energy is the mean intensity of the measurements."""
    image = problem.random_starts(starts, rng)
    energy = problem.intensity.mean((-2, -1), keepdim=True)
    return Images(image * (energy / image.square().sum((-2, -1), keepdim=True).clamp_min(1e-30)).sqrt())


@dataclass(frozen=True)
class Twf(Solver[Images]):
    """Retrieve real images of either sign from the measurements that satisfy both truncation rules.

    Attributes:
        step_size: step along the gradient.
        lower, upper: limits of |a z| / |z|.
        spread: limit of the intensity error in multiples of the typical error.
    """

    step_size: float = 0.2
    lower: float = 0.3
    upper: float = 5.0
    spread: float = 5.0

    def typical(self, error: torch.Tensor) -> torch.Tensor:
        """Return the typical intensity error of each image, (..., n, n) to (..., 1, 1): the mean."""
        return error.mean((-2, -1), keepdim=True)

    def init(self, problem: PhaseProblem, rng: torch.Generator) -> Images:
        return start_at_scale(problem, self.starts, rng)

    def step(self, problem: PhaseProblem, state: Images, number: int) -> Images:
        image, intensity = state.image, problem.intensity
        spectrum = torch.fft.fft2(image)
        magnitude = spectrum.abs()
        norm = image.square().sum((-2, -1), keepdim=True).sqrt().clamp_min(1e-30)
        error = (intensity - magnitude.square()).abs()
        near = error <= self.spread * self.typical(error) * magnitude / norm
        kept = (magnitude >= self.lower * norm) & (magnitude <= self.upper * norm) & near
        return Images(image - self.step_size * poisson_gradient(spectrum, intensity, kept) * problem.support)
