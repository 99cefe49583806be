"""ADMM with a total-variation prior: modulus, sparse gradients, support and non-negativity in turn.

minimise  1/2 || |F x| - m ||^2 + weight || D x ||_1,2   over supported, non-negative x

The splitting of Heide et al., ACM Transactions on Graphics 35, 84 (2016), doi:10.1145/2897824.2925875: one copy of x for
each term, and a quadratic step for x that one FFT solves. Boyd et al., doi:10.1561/2200000016, section 3.1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from invert.solvers.base import Images, PhaseProblem, Solver, to_modulus


def gradients(image: torch.Tensor) -> torch.Tensor:
    """Return periodic forward differences, (..., 2, n, n)."""
    return torch.stack((torch.roll(image, -1, -2) - image, torch.roll(image, -1, -1) - image), -3)


def divergence(field: torch.Tensor) -> torch.Tensor:
    """Return the negative adjoint of `gradients`."""
    row, column = field.unbind(-3)
    return row - torch.roll(row, 1, -2) + column - torch.roll(column, 1, -1)


def shrink_gradients(field: torch.Tensor, threshold: torch.Tensor) -> torch.Tensor:
    """Shorten every gradient vector by `threshold`, (..., 2, n, n): the proximal map of isotropic total variation."""
    length = field.square().sum(-3, keepdim=True).sqrt()
    return field * (1.0 - threshold / length.clamp_min(1e-30)).clamp_min(0.0)


@dataclass(frozen=True)
class AdmmTvState(Images):
    """Images, the scaled dual variables of modulus, support and gradient, and the quadratic term that an FFT divides by."""

    dual_modulus: torch.Tensor
    dual_support: torch.Tensor
    dual_gradient: torch.Tensor
    quadratic: torch.Tensor


@dataclass(frozen=True)
class AdmmTv(Solver[AdmmTvState]):
    """Retrieve non-negative images.

    Attributes:
        weight: weight of the prior in units of the image mean over its support.
        coupling: penalty weight of the gradient splitting.
        error_reduction: number of last iterations that are plain error reduction.
    """

    weight: float = 0.02
    coupling: float = 1.0
    error_reduction: int = 100

    def init(self, problem: PhaseProblem, rng: torch.Generator) -> AdmmTvState:
        image = problem.random_starts(self.starts, rng)
        quadratic = 2.0 + self.coupling * _laplacian(problem)
        duals = (torch.zeros_like(image), torch.zeros_like(image), torch.zeros_like(gradients(image)))
        return AdmmTvState(image, *duals, quadratic)

    def step(self, problem: PhaseProblem, state: AdmmTvState, number: int) -> AdmmTvState:
        image, target, support = state.image, problem.target, problem.support
        if number >= self.iterations - self.error_reduction:
            return replace(state, image=to_modulus(image, target).clamp_min_(0.0).mul_(support))
        threshold = self.weight / self.coupling * (target[..., :1, :1] / support.sum()).unsqueeze(-3)
        seen = to_modulus(image + state.dual_modulus, target)
        kept = (image + state.dual_support).clamp_min(0.0) * support
        edges = shrink_gradients(gradients(image) + state.dual_gradient, threshold)
        right = (seen - state.dual_modulus) + (kept - state.dual_support)
        right = right - self.coupling * divergence(edges - state.dual_gradient)
        image = torch.fft.irfft2(torch.fft.rfft2(right) / state.quadratic, s=support.shape)
        return AdmmTvState(
            image,
            state.dual_modulus.add_(image - seen),
            state.dual_support.add_(image - kept),
            state.dual_gradient.add_(gradients(image) - edges),
            state.quadratic,
        )


def _laplacian(problem: PhaseProblem) -> torch.Tensor:
    """Return the negative periodic Laplacian in the half Fourier plane, (n, n // 2 + 1)."""
    side = problem.modulus.shape[-2]
    wave = 2.0 - 2.0 * torch.cos(2.0 * torch.pi * torch.fft.fftfreq(side, device=problem.modulus.device))
    return wave[:, None] + wave[None, : side // 2 + 1]
