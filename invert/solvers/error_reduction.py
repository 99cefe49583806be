"""Error reduction: alternate projections onto modulus, support and non-negativity.

Gerchberg, Optik 35, 237 (1972); Fienup, Applied Optics 21, 2758 (1982), doi:10.1364/AO.21.002758.
"""

from __future__ import annotations

from dataclasses import dataclass

from invert.solvers.base import Images, PhaseProblem, Solver, to_modulus


@dataclass(frozen=True)
class ErrorReduction(Solver[Images]):
    """Retrieve non-negative images. The residual never rises."""

    iterations: int = 2000

    def step(self, problem: PhaseProblem, state: Images, number: int) -> Images:
        return Images(to_modulus(state.image, problem.target).clamp_min_(0.0).mul_(problem.support))
