"""Relaxed averaged alternating reflections.

Luke, Inverse Problems 21, 37 (2005), doi:10.1088/0266-5611/21/1/004, Eq. 16: with the modulus projection P x, pixels at which the
reflected image 2 P x - x satisfies the constraints become P x, all others beta x + (1 - 2 beta) P x.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.solvers.base import Candidates, Progress, box_support, modulus_residual, no_progress, random_starts, to_modulus


@dataclass(frozen=True)
class RaarOptions:
    """Options: `beta` as published for noisy data; the last `error_reduction` iterations are error reduction."""

    iterations: int = 2000
    beta: float = 0.87
    starts: int = 16
    error_reduction: int = 100


def raar(
    modulus: torch.Tensor, box: int, rng: torch.Generator, options: RaarOptions | None = None, progress: Progress = no_progress
) -> Candidates:
    """Retrieve non-negative images; arguments as in `hio`."""
    options = options or RaarOptions()
    target, support = modulus.unsqueeze(-3), box_support(modulus, box)
    image = random_starts(modulus, support, options.starts, rng)
    for iteration in range(options.iterations):
        projected = to_modulus(image, target)
        if iteration < options.iterations - options.error_reduction:
            kept = (2.0 * projected).sub_(image).mul_(support).clamp_min_(0.0).sign_()
            image = image.mul_(options.beta).add_(projected, alpha=1.0 - 2.0 * options.beta).lerp_(projected, kept)
        else:
            image = projected.clamp_min_(0.0).mul_(support)
        progress()
    return Candidates(image, modulus_residual(image, target))
