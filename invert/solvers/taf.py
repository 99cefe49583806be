"""Truncated amplitude flow: gradient descent on the amplitude error over frequencies with reliable phases.

Wang, Giannakis and Eldar, IEEE Transactions on Information Theory 64, 773 (2018), doi:10.1109/TIT.2017.2756858,
algorithm 1 with its published constants. The starts are random, because the orthogonality-promoting start assumes Gaussian
measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.solvers.base import Candidates, Progress, box_support, modulus_residual, no_progress
from invert.solvers.twf import full_intensity, start_at_scale


@dataclass(frozen=True)
class TafOptions:
    """Options. `gamma`: exclude frequencies whose modulus |a z| is below the measured psi / (1 + gamma); `step`: step size."""

    iterations: int = 1000
    starts: int = 16
    step: float = 0.6
    gamma: float = 0.7


def amplitude_gradient(spectrum: torch.Tensor, amplitude: torch.Tensor, kept: torch.Tensor) -> torch.Tensor:
    """Return the gradient of mean((|a z| - psi)^2) / 2 over the kept measurements with respect to a real image z."""
    scale = 1.0 - amplitude / spectrum.abs().clamp_min(1e-30)
    return torch.fft.ifft2(spectrum * (scale * kept)).real


def taf(
    modulus: torch.Tensor, box: int, rng: torch.Generator, options: TafOptions | None = None, progress: Progress = no_progress
) -> Candidates:
    """Retrieve real images of either sign; arguments as in `hio`."""
    options = options or TafOptions()
    support, amplitude = box_support(modulus, box), full_intensity(modulus).sqrt()
    image = start_at_scale(modulus, support, options.starts, rng)
    for _ in range(options.iterations):
        spectrum = torch.fft.fft2(image)
        kept = spectrum.abs() * (1.0 + options.gamma) >= amplitude
        image = image - options.step * amplitude_gradient(spectrum, amplitude, kept) * support
        progress()
    return Candidates(image, modulus_residual(image, modulus.unsqueeze(-3)))
