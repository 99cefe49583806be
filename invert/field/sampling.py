"""Samples of the posterior of a field by underdamped Langevin dynamics, and their means.

In dim frames, the most probable field predicts held-out pixels worse than a Wiener filter does; the mean over samples predicts them
better. The counts do not determine the global phase of a field, so a mean field exists only because the dynamics are short and stay near
the field from which they start. The steps are those of the splitting BAOAB (Leimkuhler and Matthews,
doi:10.1093/amrx/abs010), with unit masses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from invert.field.forward_model import power
from invert.field.posterior import FieldPosterior

STEP = 0.7
"""Duration of a step for masses of 1; a cell oscillates with a period of about 4.4, and steps above 1 diverge."""

FRICTION = 0.5
"""Friction per unit of that time."""


@dataclass
class SamplingState:
    """Field in the units of `FieldPosterior`, its velocity, the gradient of the negative log-posterior, and the expected counts on the
    frame.
    """

    field: torch.Tensor
    velocity: torch.Tensor
    gradient: torch.Tensor
    expected: torch.Tensor


@dataclass(frozen=True)
class PosteriorMean:
    """Means over samples: expected counts (frame rows, frame columns), field E and |E|^2 (modes, box rows, box columns)."""

    expected: torch.Tensor
    field: torch.Tensor
    power: torch.Tensor


class Sampling:
    """Langevin dynamics for one frame.

    Args:
        rng: random numbers on the device of the posterior.
    """

    def __init__(self, posterior: FieldPosterior, rng: torch.Generator) -> None:
        self._posterior, self._rng = posterior, rng

    def init(self, field: torch.Tensor) -> SamplingState:
        """Return the state of a field on the object, with a random velocity."""
        scaled = self._posterior.scale(field)
        return SamplingState(scaled, self._kick(scaled), *self._posterior.gradient(scaled))

    def step(self, state: SamplingState) -> None:
        """Advance the state by one step."""
        kept = math.exp(-FRICTION * STEP)
        state.velocity -= 0.5 * STEP * state.gradient
        state.field = state.field + 0.5 * STEP * state.velocity
        state.velocity = kept * state.velocity + math.sqrt(1.0 - kept**2) * self._kick(state.field)
        state.field += 0.5 * STEP * state.velocity
        state.gradient, state.expected = self._posterior.gradient(state.field)
        state.velocity -= 0.5 * STEP * state.gradient

    def run(self, field: torch.Tensor, first: int, steps: int) -> PosteriorMean:
        """Return the means over `steps` steps from a field on the object, after `first` steps that are discarded."""
        state = self.init(field)
        expected, total, strength = torch.zeros_like(state.expected), torch.zeros_like(field), torch.zeros_like(power(field))
        for number in range(first + steps):
            self.step(state)
            if number >= first:
                expected += state.expected
                sample = self._posterior.field(state.field)
                total += sample
                strength += power(sample)
        return PosteriorMean(expected / steps, total / steps, strength / steps)

    def _kick(self, like: torch.Tensor) -> torch.Tensor:
        """Return a random thermal velocity: real and imaginary part of variance 1."""
        parts = torch.randn(2, *like.shape, generator=self._rng, device=like.device)
        return torch.complex(*parts) * self._posterior.is_free
