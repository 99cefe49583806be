"""Hybrid input-output phase retrieval with shrink-wrap, many images and starts in one batch.

Fienup, Applied Optics 21, 2758 (1982), Eq. 44, doi:10.1364/AO.21.002758; shrink-wrap: Marchesini et
al., Physical Review B 68, 140101 (2003), doi:10.1103/PhysRevB.68.140101.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from invert.solvers.base import Images, PhaseProblem, Solver, gaussian_blur, to_modulus


@dataclass(frozen=True)
class HioState(Images):
    """Images, the support of each start, and the blur of its next update in pixels."""

    support: torch.Tensor
    blur: float


@dataclass(frozen=True)
class Hio(Solver[HioState]):
    """Retrieve real, non-negative images; published options (Metzler et al. 2020, section 6.C) with shrink-wrap.

    Attributes:
        iterations: total number of projections; the last `error_reduction` of them are plain error reduction.
        beta: feedback of the pixels that violate the constraints.
        shrink_from, shrink_every: first iteration and interval of support updates; 0 for none.
        shrink_threshold: fractions of the blurred image's maximum, cycled over the starts.
        shrink_blur: first and last standard deviation of the blur, in pixels; it falls by 5 % each time.
    """

    iterations: int = 2000
    beta: float = 0.9
    error_reduction: int = 100
    shrink_from: int = 300
    shrink_every: int = 100
    shrink_threshold: tuple[float, ...] = (0.03,)
    shrink_blur: tuple[float, float] = (4.0, 2.0)

    def init(self, problem: PhaseProblem, rng: torch.Generator) -> HioState:
        return HioState(problem.random_starts(self.starts, rng), problem.support, self.shrink_blur[0])

    def step(self, problem: PhaseProblem, state: HioState, number: int) -> HioState:
        projected = to_modulus(state.image, problem.target)
        allowed = (projected * state.support).clamp_min_(0.0).sign_()  # 1 where the constraints hold, else 0
        if number >= self.iterations - self.error_reduction:
            return replace(state, image=projected.mul_(allowed))
        # projected where allowed, image - beta projected elsewhere
        image = state.image.sub_(projected, alpha=self.beta).lerp_(projected, allowed)
        if not self.shrink_every or number < self.shrink_from or number % self.shrink_every:
            return replace(state, image=image)
        smooth = gaussian_blur(projected * allowed, state.blur)
        support = (smooth > self._thresholds(smooth) * smooth.amax((-2, -1), keepdim=True)).float()
        return HioState(image, support, max(self.shrink_blur[1], 0.95 * state.blur))

    def _thresholds(self, images: torch.Tensor) -> torch.Tensor:
        """Return the threshold of each start, (starts, 1, 1)."""
        cycled = torch.tensor(self.shrink_threshold, device=images.device).repeat(self.starts)
        return cycled[: self.starts, None, None]
