"""Posterior of the field of one frame: likelihood of its counts times the prior E_j ~ CN(0, q_j).

The counts of a frame together add about 2 v to the second derivative of its negative logarithm by the real part of E_j, because the
transform to the wall is unitary; v is the relative illumination. The prior adds 2 / q_j. Fields are therefore in units of the least
deviation that both leave, E = s V with s^2 = q / (1 + v q) and the largest v: no cell then has a curvature above 4.
"""

from __future__ import annotations

import torch

from invert.field.counts import FrameCounts
from invert.field.forward_model import ForwardModel, expected_counts


class FieldPosterior:
    """Posterior of fields V (modes, box rows, box columns): exp(-sum(I - n log I) - sum |V|^2 / (1 + v q)), with the expected counts I of
    the forward model; counts of a rough wall are negative binomial instead.

    Args:
        prior: q, expected |E|^2 of each mode in counts (box rows, box columns); the field is zero where it is zero.
    """

    def __init__(self, model: ForwardModel, counts: FrameCounts, prior: torch.Tensor) -> None:
        self._model, self._counts = model, counts
        self._stiffness = 1.0 / (1.0 + float(counts.illumination.max()) * prior)
        self._unit = (prior * self._stiffness).sqrt()
        self._weight = counts.fitted.to(prior.dtype)
        self.is_free = prior > 0.0

    def scale(self, field: torch.Tensor) -> torch.Tensor:
        """Return the V of a field on the object."""
        return torch.where(self.is_free, field / self._unit.clamp_min(1e-30), torch.zeros_like(field))

    def field(self, scaled: torch.Tensor) -> torch.Tensor:
        """Return the field E on the object."""
        return self._unit * scaled

    def gradient(self, scaled: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the gradient of the negative log-posterior, its derivatives by real and imaginary part as one complex number per cell;
        and the expected counts on the frame.
        """
        wall = self._model.grid.to_wall(self.field(scaled))
        expected = expected_counts(self._model.intensity(wall), self._counts)
        residual = self._weight * self._counts.illumination * (1.0 - self._counts.values / expected)
        residual /= 1.0 + self._counts.roughness * expected
        return 2.0 * (self._unit * self._model.gradient(residual, wall) + self._stiffness * scaled), expected
