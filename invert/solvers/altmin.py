"""Alternating minimisation: phases from the image, image from the phases; the support is the only constraint.

Netrapalli, Jain and Sanghavi, NeurIPS 2013, arXiv:1306.0160, algorithm 1 without resampling, as in Metzler et al. 2020 (1000
iterations). For Fourier measurements of an image in a support, the least-squares step is a projection onto the support. The starts
are random, because the spectral start assumes Gaussian measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

from invert.solvers.base import Images, PhaseProblem, Solver, to_modulus


@dataclass(frozen=True)
class AltMin(Solver[Images]):
    """Retrieve real images of either sign."""

    def step(self, problem: PhaseProblem, state: Images, number: int) -> Images:
        return Images(to_modulus(state.image, problem.target).mul_(problem.support))
