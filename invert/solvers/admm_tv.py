"""ADMM with a total-variation prior: modulus, sparse gradients, support and non-negativity in turn.

minimise  1/2 || |F x| - m ||^2 + weight || D x ||_1,2   over supported, non-negative x

The splitting of Heide et al., ACM Transactions on Graphics 35, 84 (2016), doi:10.1145/2897824.2925875: one copy of x for
each term, and a quadratic step for x that one FFT solves. Boyd et al., doi:10.1561/2200000016, section 3.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.solvers.base import Candidates, Progress, box_support, modulus_residual, no_progress, random_starts, to_modulus


@dataclass(frozen=True)
class AdmmTvOptions:
    """`weight` of the prior in units of the image mean over its support; `coupling`: penalty weight of the gradient splitting."""

    iterations: int = 1000
    starts: int = 16
    weight: float = 0.02
    coupling: float = 1.0
    error_reduction: int = 100


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


def admm_tv(
    modulus: torch.Tensor,
    box: int,
    rng: torch.Generator,
    options: AdmmTvOptions | None = None,
    progress: Progress = no_progress,
) -> Candidates:
    """Retrieve non-negative images; arguments as in `hio`."""
    options = options or AdmmTvOptions()
    target, support = modulus.unsqueeze(-3), box_support(modulus, box)
    side = modulus.shape[-2]
    wave = 2.0 - 2.0 * torch.cos(2.0 * torch.pi * torch.fft.fftfreq(side, device=modulus.device))
    laplacian = wave[:, None] + wave[None, : side // 2 + 1]
    image = random_starts(modulus, support, options.starts, rng)
    threshold = options.weight / options.coupling * (target[..., :1, :1] / support.sum()).unsqueeze(-3)
    dual_modulus, dual_support = torch.zeros_like(image), torch.zeros_like(image)
    dual_gradient = torch.zeros_like(gradients(image))
    for _ in range(options.iterations - options.error_reduction):
        seen = to_modulus(image + dual_modulus, target)
        kept = (image + dual_support).clamp_min(0.0) * support
        edges = shrink_gradients(gradients(image) + dual_gradient, threshold)
        right = (seen - dual_modulus) + (kept - dual_support) - options.coupling * divergence(edges - dual_gradient)
        image = torch.fft.irfft2(torch.fft.rfft2(right) / (2.0 + options.coupling * laplacian), s=(side, side))
        dual_modulus += image - seen
        dual_support += image - kept
        dual_gradient += gradients(image) - edges
        progress()
    for _ in range(options.error_reduction):
        image = to_modulus(image, target).clamp_min_(0.0).mul_(support)
        progress()
    return Candidates(image, modulus_residual(image, target))
