"""Search of a field: ADMM between the Gaussian prior and the Poisson data, from a random field.

It minimises |E|^2 / p + |Z|^2 - d log |Z|^2 with Z = F E (Boyd et al., doi:10.1561/2200000016). Three deviations from the textbook
are essential: under-relaxation, a prior sharper than the albedo (its square), and a penalty rho that rises during the search.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.field.counts import FrameCounts
from invert.field.forward_model import ForwardModel, power

FIRST_RHO, RHO_RATIO = 0.05, 6.0
"""First penalty of ADMM in units of the curvature of the data term, and the factor by which it rises."""

RELAXATION = 0.6
"""Fraction of a step of ADMM that is taken."""

PRIOR_STRENGTH = 8.0
"""First penalty times the mean of the prior, weighted by itself; it sets how strongly dark cells are suppressed."""

MIN_POWER = 1e-12
"""Power of the field on the wall below which its phase counts as random."""


@dataclass
class SearchState:
    """State of ADMM on the periodic grid: the field V before the proximal map of the data, and the factor by which that map
    multiplies it. Both ADMM variables follow from them: Z = factor V, and the dual variable Y = (factor - 1) V.
    """

    before: torch.Tensor
    factor: torch.Tensor


class Search:
    """ADMM for one frame; fields have the shape (modes, box rows, box columns).

    Args:
        target: intensity on the frame, filtered and deconvolved (`invert.field.filtering`).
        prior: expected |E|^2 (box rows, box columns), any scale.
        modes: number of polarisation modes.
    """

    def __init__(
        self, model: ForwardModel, counts: FrameCounts, target: torch.Tensor, prior: torch.Tensor, modes: int = 1
    ) -> None:
        self._modes = modes
        self._grid, self._target, self._fitted = model.grid, model.grid.on_frame(target), counts.fitted.to(target.dtype)
        sharp = prior.square()
        self.prior = sharp * (PRIOR_STRENGTH / FIRST_RHO * sharp.sum() / sharp.square().sum())

    def random_field(self, rng: torch.Generator) -> torch.Tensor:
        """Return a random field on the object with the prior's power."""
        parts = torch.randn(2, self._modes, *self.prior.shape, generator=rng)
        return torch.complex(*parts).to(self.prior.device) * (0.5 * self.prior).sqrt()

    def init(self, field: torch.Tensor) -> SearchState:
        """Return the state of a field on the object."""
        state = SearchState(self._grid.to_wall(field), self.prior.new_ones(self._grid.shape))
        self._apply_data(state, FIRST_RHO)
        return state

    def step(self, state: SearchState, progress: float) -> torch.Tensor:
        """Advance the state by one step; return the field on the object. `progress` runs from 0 to 1 over the search."""
        rho = FIRST_RHO * RHO_RATIO**progress
        field = self._grid.to_object(state.before * state.factor.mul(2.0).sub_(1.0))
        field *= rho * self.prior / (1.0 + rho * self.prior)
        state.before.mul_(state.factor.mul_(-RELAXATION).add_(1.0)).add_(self._grid.to_wall(field), alpha=RELAXATION)
        self._apply_data(state, rho)
        return field

    def run(self, field: torch.Tensor, steps: int) -> torch.Tensor:
        """Return the field on the object after a number of steps from a field."""
        state = self.init(field)
        for number in range(steps):
            field = self.step(state, number / steps)
        return field

    def _apply_data(self, state: SearchState, rho: float) -> None:
        """Update the factor: the proximal map of the Poisson likelihood where counts are fitted, 1 elsewhere."""
        strength = power(self._grid.on_frame(state.before)).sum(0).clamp_min_(MIN_POWER)
        factor = strength.reciprocal_().mul_(self._target).mul_(4.0 * (1.0 + rho)).add_(rho**2).sqrt_()
        factor = factor.add_(rho).mul_(0.5 / (1.0 + rho)).sub_(1.0).mul_(self._fitted).add_(1.0)
        self._grid.on_frame(state.factor).copy_(factor)
