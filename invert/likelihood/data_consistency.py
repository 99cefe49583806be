"""Data-consistency steps: ascent of the likelihood of albedos under a Gaussian prior around their initial values."""

from __future__ import annotations

import torch

from invert.likelihood.gamma import Likelihood

MAX_ALBEDO = 1.2
"""Maximum albedo of a step; the maximum of an object is about 1."""

MAX_STEP_LENGTH = 1.0
"""Maximum step length; 1 is the Newton step of each pixel on its own (diagonal preconditioner)."""


def run_data_consistency_steps(
    likelihood: Likelihood, albedo: torch.Tensor, variance: torch.Tensor, steps: int, explained: float = 0.0
) -> torch.Tensor:
    """Move albedos (n, 64, 64) up their likelihood given their estimates, under a Gaussian prior around the initial values.

    Each is a preconditioned conjugate-gradient step whose length follows from the curvature. Pixels of zero albedo stay at
    zero if the gradient of the log-likelihood there is negative.

    Args:
        variance: variance of the prior, (n,).
        explained: reduced deviance below which an albedo remains unchanged, because the rest may be noise.
    """
    begun, precision = albedo, variance.reciprocal()[:, None, None]
    at = likelihood.at(albedo)
    preconditioner = (at.information() + precision).reciprocal()
    direction = former = torch.zeros_like(albedo)
    former_norm, is_unexplained = torch.ones_like(precision), torch.ones_like(precision)
    for step in range(steps):
        at = likelihood.at(albedo) if step else at
        if explained:
            is_unexplained = (at.deviance() > explained)[:, None, None]
            if not bool(is_unexplained.any()):
                break
        slope = at.gradient() + precision * (begun - albedo)
        slope = slope * ((albedo > 0.0) | (slope > 0.0)) * is_unexplained
        steepest = preconditioner * slope
        conjugate = (_dot(slope - former, steepest) / former_norm).clamp_min(0.0)  # Polak and Ribiere
        direction = steepest + conjugate * direction * (slope != 0.0)
        direction = torch.where(_dot(direction, slope) > 0.0, direction, steepest)
        former, former_norm = slope, _dot(slope, steepest).clamp_min(1e-30)
        bend = at.curvature(direction)[:, None, None] + _dot(direction, precision * direction)
        length = (_dot(slope, direction) / bend.clamp_min(1e-30)).clamp_max(MAX_STEP_LENGTH)
        albedo = (albedo + length * direction).clamp(0.0, MAX_ALBEDO)
    return albedo


def _dot(one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    return (one * other).sum((-2, -1), keepdim=True)
