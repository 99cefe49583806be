"""Data-consistency steps: ascent of the likelihood of albedos under a Gaussian prior around their initial values."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from invert.likelihood.gamma import Likelihood, LikelihoodPoint

MAX_ALBEDO = 1.2
"""Maximum albedo of a step; the maximum of an object is about 1."""

MAX_STEP_LENGTH = 1.0
"""Maximum step length; 1 is the Newton step of each pixel on its own (diagonal preconditioner)."""


@dataclass(frozen=True)
class Ascent:
    """State of the ascent of n albedos.

    Attributes:
        albedo: (n, 64, 64).
        at: the likelihood there.
        begun: initial albedos, the means of the prior.
        precision: inverse variance of the prior, (n, 1, 1).
        preconditioner: inverse curvature of each pixel at the beginning, (n, 64, 64).
        direction, slope: direction and slope of the last step, (n, 64, 64).
        norm: preconditioned square of the slope, (n, 1, 1).
    """

    albedo: torch.Tensor
    at: LikelihoodPoint
    begun: torch.Tensor
    precision: torch.Tensor
    preconditioner: torch.Tensor
    direction: torch.Tensor
    slope: torch.Tensor
    norm: torch.Tensor

    @classmethod
    def begin(cls, likelihood: Likelihood, albedo: torch.Tensor, variance: torch.Tensor) -> Ascent:
        """Return the state before the first step, with a prior of variance (n,) around the albedos."""
        at, precision = likelihood.at(albedo), variance.reciprocal()[:, None, None]
        preconditioner, zeros = (at.information() + precision).reciprocal(), torch.zeros_like(albedo)
        return cls(albedo, at, albedo, precision, preconditioner, zeros, zeros, torch.ones_like(precision))

    def step(self, moves: torch.Tensor | float = 1.0) -> Ascent:
        """Take a preconditioned conjugate-gradient step whose length follows from the curvature.

        Pixels of zero albedo stay at zero if the gradient of the log-likelihood there is negative. The state returned has the
        likelihood of the albedo before; see `evaluate`.

        Args:
            moves: whether each albedo moves, (n, 1, 1).
        """
        slope = self.at.gradient() + self.precision * (self.begun - self.albedo)
        slope = slope * ((self.albedo > 0.0) | (slope > 0.0)) * moves
        steepest = self.preconditioner * slope
        conjugate = (_dot(slope - self.slope, steepest) / self.norm).clamp_min(0.0)  # Polak and Ribiere
        direction = steepest + conjugate * self.direction * (slope != 0.0)
        direction = torch.where(_dot(direction, slope) > 0.0, direction, steepest)
        bend = self.at.curvature(direction)[:, None, None] + _dot(direction, self.precision * direction)
        length = (_dot(slope, direction) / bend.clamp_min(1e-30)).clamp_max(MAX_STEP_LENGTH)
        albedo = (self.albedo + length * direction).clamp(0.0, MAX_ALBEDO)
        return replace(self, albedo=albedo, direction=direction, slope=slope, norm=_dot(slope, steepest).clamp_min(1e-30))

    def run(self, likelihood: Likelihood, steps: int) -> torch.Tensor:
        """Take steps from the beginning; return the albedos."""
        ascent = self
        for number in range(steps):
            ascent = (ascent.evaluate(likelihood) if number else ascent).step()
        return ascent.albedo

    def evaluate(self, likelihood: Likelihood) -> Ascent:
        """Return the state with the likelihood of its albedo."""
        return replace(self, at=likelihood.at(self.albedo))


def run_data_consistency_steps(
    likelihood: Likelihood, albedo: torch.Tensor, variance: torch.Tensor, steps: int
) -> torch.Tensor:
    """Move albedos (n, 64, 64) up their likelihood, under a Gaussian prior of variance (n,) around the initial values."""
    return Ascent.begin(likelihood, albedo, variance).run(likelihood, steps)


def ascend_to_deviance(
    likelihood: Likelihood, albedo: torch.Tensor, variance: torch.Tensor, deviance: torch.Tensor, steps: int
) -> torch.Tensor:
    """Move albedos (n, 64, 64) up their likelihood until their reduced deviance is as low as that of each, (n,).

    The last step is shortened so that it ends there. Albedos of a lower deviance stay, because the rest may be noise.
    """
    ascent = Ascent.begin(likelihood, albedo, variance)
    present = ascent.at.deviance()
    for _ in range(steps):
        moves = present > deviance
        if not bool(moves.any()):
            break
        reached = ascent.step(moves[:, None, None]).evaluate(likelihood)
        lower = reached.at.deviance()
        share = ((present - deviance) / (present - lower).clamp_min(1e-9)).clamp(0.0, 1.0) * moves
        between = ascent.albedo + share[:, None, None] * (reached.albedo - ascent.albedo)
        present = torch.where(moves, torch.maximum(lower, deviance), present)
        ascent = replace(reached, albedo=between)
    return ascent.albedo


def _dot(one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    return (one * other).sum((-2, -1), keepdim=True)
