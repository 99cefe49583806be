"""Refinement of a field: nonlinear conjugate gradients on the exact posterior.

The objective is sum(I - n log I) + sum |E|^2 / q with the expected counts I of the forward model. In units of the prior, E = sqrt(q) W,
the prior is |W|^2, which preconditions the problem. The intensity along a direction is a quadratic polynomial, so each line search
costs no Fourier transform (Polak and Ribiere; Nocedal and Wright, Numerical Optimization, Eq. 5.44).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.field.counts import FrameCounts
from invert.field.forward_model import ForwardModel, expected_counts, log_likelihood, power

NEWTON_STEPS = 3
"""Newton steps of a line search."""

MIN_STEP = 1e-6
"""Length of a step, in units of the search direction, below which a line search ends without one."""


@dataclass
class RefinementState:
    """State of conjugate gradients: field in units of the prior, on the wall, its intensity on the frame, last direction and
    gradient (None at the start), and the objective in nats.
    """

    field: torch.Tensor
    wall: torch.Tensor
    intensity: torch.Tensor
    objective: float
    direction: torch.Tensor | None = None
    gradient: torch.Tensor | None = None


class Refinement:
    """Conjugate gradients for one frame.

    Args:
        prior: expected |E|^2 of each mode in counts (box rows, box columns); the field is zero where it is zero.
    """

    def __init__(self, model: ForwardModel, counts: FrameCounts, prior: torch.Tensor) -> None:
        self._model, self._counts, self._root = model, counts, prior.sqrt()
        self._weight = counts.fitted.to(prior.dtype)

    def init(self, field: torch.Tensor) -> RefinementState:
        """Return the state of a field on the object."""
        scaled = torch.where(self._root > 0.0, field / self._root.clamp_min(1e-30), torch.zeros_like(field))
        wall = self._model.grid.to_wall(self._root * scaled)
        intensity = self._model.intensity(wall)
        return RefinementState(scaled, wall, intensity, self._data_term(intensity) + _square(scaled))

    def step(self, state: RefinementState) -> None:
        """Advance the state by one step; the objective never rises."""
        expected = expected_counts(state.intensity, self._counts)
        residual = self._weight * self._counts.illumination * (1.0 - self._counts.values / expected)
        residual /= 1.0 + self._counts.roughness * expected
        gradient = self._root * self._model.gradient(residual, state.wall) + state.field * (self._root > 0.0)
        direction = -gradient
        if state.direction is not None and state.gradient is not None:
            turned = _inner(gradient, gradient) - _inner(gradient, state.gradient)
            direction += max(0.0, turned / _square(state.gradient)) * state.direction
            if _inner(gradient, direction) >= 0.0:
                direction = -gradient
        wall = self._model.grid.to_wall(self._root * direction)
        slope, curvature = self._model.cross_intensity(state.wall, wall), self._model.intensity(wall)
        inner, square = 2.0 * _inner(state.field, direction), _square(direction)
        prior = _square(state.field)
        length, objective = self._search_line(state, slope, curvature, (prior, inner, square))
        state.direction, state.gradient = direction, gradient
        if objective < state.objective:
            state.field = state.field + length * direction
            state.wall = state.wall + length * wall
            state.intensity = state.intensity + length * slope + length**2 * curvature
            state.objective = objective
        else:
            state.direction = None

    def run(self, field: torch.Tensor, steps: int) -> RefinementState:
        """Return the state after a number of steps from a field on the object."""
        state = self.init(field)
        for _ in range(steps):
            self.step(state)
        return state

    def field(self, state: RefinementState) -> torch.Tensor:
        """Return the field on the object."""
        return self._root * state.field

    def expected(self, state: RefinementState) -> torch.Tensor:
        """Return the expected counts on the frame."""
        return expected_counts(state.intensity, self._counts)

    def _data_term(self, intensity: torch.Tensor) -> float:
        likelihood = log_likelihood(self._counts.values, expected_counts(intensity, self._counts), self._counts.roughness)
        return -float((self._weight * likelihood).sum(dtype=torch.float64))

    def _search_line(
        self, state: RefinementState, slope: torch.Tensor, curvature: torch.Tensor, prior: tuple[float, float, float]
    ) -> tuple[float, float]:
        """Return length of the step and objective, from the intensity a + b t + c t^2 and the prior, a polynomial in t as well."""
        counts, lit, length = self._counts.values, self._counts.illumination, 0.0
        for _ in range(NEWTON_STEPS):
            expected = expected_counts(state.intensity + length * slope + length**2 * curvature, self._counts)
            change = lit * (slope + 2.0 * length * curvature)
            ratio, noise = counts / expected, 1.0 + self._counts.roughness * expected
            slope_of_term = (1.0 - ratio) / noise
            first = float((self._weight * change * slope_of_term).sum()) + prior[1] + 2.0 * length * prior[2]
            bent = 2.0 * lit * curvature * slope_of_term
            bent += change.square() * (ratio / expected - self._counts.roughness * slope_of_term) / noise
            second = float((self._weight * bent).sum()) + 2.0 * prior[2]
            length -= first / second if second > 0.0 else -1e-3
        objective = float("inf")
        while abs(length) >= MIN_STEP:
            objective = self._data_term(state.intensity + length * slope + length**2 * curvature)
            objective += prior[0] + length * prior[1] + length**2 * prior[2]
            if objective < state.objective:
                break
            length *= 0.3
        return length, objective


def _square(field: torch.Tensor) -> float:
    return float(power(field).sum(dtype=torch.float64))


def _inner(first: torch.Tensor, second: torch.Tensor) -> float:
    return float((first.real * second.real + first.imag * second.imag).sum(dtype=torch.float64))
