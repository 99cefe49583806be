"""Truncated amplitude flow: gradient descent on the amplitude error over frequencies with reliable phases.

Wang, Giannakis and Eldar, IEEE Transactions on Information Theory 64, 773 (2018), doi:10.1109/TIT.2017.2756858,
algorithm 1 with its published constants. The starts are random, because the orthogonality-promoting start assumes Gaussian
measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.solvers.base import Images, PhaseProblem, Solver
from invert.solvers.twf import start_at_scale


def amplitude_gradient(spectrum: torch.Tensor, amplitude: torch.Tensor, kept: torch.Tensor) -> torch.Tensor:
    """Return the gradient of mean((|a z| - psi)^2) / 2 over the kept measurements with respect to a real image z."""
    scale = 1.0 - amplitude / spectrum.abs().clamp_min(1e-30)
    return torch.fft.ifft2(spectrum * (scale * kept)).real


@dataclass(frozen=True)
class Taf(Solver[Images]):
    """Retrieve real images of either sign.

    Attributes:
        step_size: step along the gradient.
        gamma: frequencies whose modulus |a z| is below the measured psi / (1 + gamma) are excluded.
    """

    step_size: float = 0.6
    gamma: float = 0.7

    def init(self, problem: PhaseProblem, rng: torch.Generator) -> Images:
        return start_at_scale(problem, self.starts, rng)

    def step(self, problem: PhaseProblem, state: Images, number: int) -> Images:
        spectrum, amplitude = torch.fft.fft2(state.image), problem.intensity.sqrt()
        kept = spectrum.abs() * (1.0 + self.gamma) >= amplitude
        return Images(state.image - self.step_size * amplitude_gradient(spectrum, amplitude, kept) * problem.support)
