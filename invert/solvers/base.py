"""Common parts of the classical methods: the problem, the loop, projections, residual, random starts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

import torch

from correlograph.progress import Progress, no_progress


@dataclass(frozen=True)
class Candidates:
    """Images of all starts, (..., starts, n, n), and their residuals (..., starts).

    The residual is the relative squared error of the Fourier modulus; it is independent of a truth.
    """

    images: torch.Tensor
    residual: torch.Tensor


@dataclass(frozen=True)
class PhaseProblem:
    """Fourier moduli without their phases, and the square that holds the object.

    Attributes:
        modulus: (..., n, n // 2 + 1), leading dimensions are images.
        box: side of the square in pixels, at most n / 2.
    """

    modulus: torch.Tensor
    box: int

    @property
    def target(self) -> torch.Tensor:
        """Moduli with a dimension for the starts, (..., 1, n, n // 2 + 1)."""
        return self.modulus.unsqueeze(-3)

    @cached_property
    def support(self) -> torch.Tensor:
        """1 in the square, which lies at the corner of the grid, 0 elsewhere, (n, n)."""
        side = self.modulus.shape[-2]
        support = torch.zeros(side, side, device=self.modulus.device)
        support[: self.box, : self.box] = 1.0
        return support

    @cached_property
    def intensity(self) -> torch.Tensor:
        """Squared moduli on the whole Fourier plane, (..., 1, n, n), from the half plane of a real image."""
        side = self.modulus.shape[-2]
        tail = torch.roll(self.modulus.flip(-2), 1, -2)[..., 1 : side - self.modulus.shape[-1] + 1].flip(-1)
        return torch.cat((self.modulus, tail), -1).square().unsqueeze(-3)

    def random_starts(self, starts: int, rng: torch.Generator) -> torch.Tensor:
        """Return uniform random images inside the support, (..., starts, n, n), equal for every image of a batch, so that a
        result does not depend on the rest of the batch.
        """
        side = self.modulus.shape[-2]
        images = torch.rand(starts, side, side, generator=rng, device=self.modulus.device) * self.support
        return images.expand(*self.modulus.shape[:-2], starts, side, side).clone()


@dataclass(frozen=True)
class Images:
    """State of a solver: its images (..., starts, n, n). Solvers that remember more extend it."""

    image: torch.Tensor


State = TypeVar("State", bound=Images)


@dataclass(frozen=True)
class Solver(ABC, Generic[State]):
    """A method of phase retrieval: its options, its first state, and its update rule.

    Attributes:
        iterations: number of steps.
        starts: number of random starting images.
    """

    iterations: int = 1000
    starts: int = 16

    def init(self, problem: PhaseProblem, rng: torch.Generator) -> Any:
        """Return the first state, with images drawn by `rng` (on the device of the problem)."""
        return Images(problem.random_starts(self.starts, rng))

    @abstractmethod
    def step(self, problem: PhaseProblem, state: State, number: int) -> State:
        """Return the state after step `number`, counted from zero. The arrays of the former state may be overwritten."""


def solve(solver: Solver[Any], problem: PhaseProblem, rng: torch.Generator, progress: Progress = no_progress) -> Candidates:
    """Run a solver. `progress` is called once per step."""
    state = solver.init(problem, rng)
    for number in range(solver.iterations):
        state = solver.step(problem, state, number)
        progress()
    return Candidates(state.image, modulus_residual(state.image, problem.target))


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
