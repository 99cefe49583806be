"""Relaxed averaged alternating reflections.

Luke, Inverse Problems 21, 37 (2005), doi:10.1088/0266-5611/21/1/004, Eq. 16: with the modulus projection P x, pixels at which the
reflected image 2 P x - x satisfies the constraints become P x, all others beta x + (1 - 2 beta) P x.
"""

from __future__ import annotations

from dataclasses import dataclass

from invert.solvers.base import Images, PhaseProblem, Solver, to_modulus


@dataclass(frozen=True)
class Raar(Solver[Images]):
    """Retrieve non-negative images; `beta` as published for noisy data; the last `error_reduction` iterations are error reduction."""

    iterations: int = 2000
    beta: float = 0.87
    error_reduction: int = 100

    def step(self, problem: PhaseProblem, state: Images, number: int) -> Images:
        projected = to_modulus(state.image, problem.target)
        if number >= self.iterations - self.error_reduction:
            return Images(projected.clamp_min_(0.0).mul_(problem.support))
        kept = (2.0 * projected).sub_(state.image).mul_(problem.support).clamp_min_(0.0).sign_()
        return Images(state.image.mul_(self.beta).add_(projected, alpha=1.0 - 2.0 * self.beta).lerp_(projected, kept))
