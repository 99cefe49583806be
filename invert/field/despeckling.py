"""Albedo from the intensities of several fields: by a network, or by total variation.

The network (`invert.network.despeckler`) was trained on the speckle of other objects. Total variation takes its place where it predicts
the other half of the looks with a lower squared error; their likelihood would be decided by the darkest cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from scipy import ndimage

from invert.field.total_variation import smooth_by_total_variation
from invert.network.checkpoints import DESPECKLER_WEIGHTS, load_network
from radiometry.ring_correlation import half_period

WEIGHTS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
"""Weights of the total variation, in nats per unit of the albedo's scale and pixel edge, that are tried."""

FIRST_WEIGHT = 2.0
"""Weight that is compared with the network; the others are tried only if it is better."""

DEVIATION_CELLS = 3.0
"""Standard deviation, in cells, of the Gaussian over which the squared difference between halves is averaged."""


@dataclass(frozen=True)
class Despeckled:
    """Albedo (rows, columns) in the unit of |E|^2; the two halves of the looks despeckled alike, None for one frame.

    `weight` is that of the total variation, None for the network.
    """

    albedo: torch.Tensor
    halves: tuple[torch.Tensor, torch.Tensor] | None
    weight: float | None = None

    @property
    def deviation(self) -> torch.Tensor | None:
        """Standard deviation of the albedo, local root mean square of half of the difference between the halves."""
        if self.halves is None:
            return None
        square = (0.25 * (self.halves[0] - self.halves[1]).square()).numpy()
        return torch.from_numpy(ndimage.gaussian_filter(square, DEVIATION_CELLS)).sqrt()

    @property
    def agreement(self) -> float | None:
        """Pearson correlation of the halves; None for one frame."""
        if self.halves is None:
            return None
        return float(torch.corrcoef(torch.stack([half.flatten() for half in self.halves]))[0, 1])

    def resolution(self, pitches: tuple[float, float]) -> float | None:
        """Return the resolution in the unit of the pitches of the cells; None for one frame."""
        if self.halves is None:
            return None
        first, second = (half.numpy().astype(np.float64) for half in self.halves)
        return half_period(first, second, pitches)


def despeckle(intensity: torch.Tensor) -> Despeckled:
    """Despeckle |E|^2 (frames, modes, rows, columns) by the method that predicts held-out frames best; by the network if there is one
    frame.
    """
    looks = intensity.shape[0] * intensity.shape[1]
    if len(intensity) == 1:
        return Despeckled(_smooth(intensity.mean((0, 1)), looks, None), None)
    parts = [intensity[part::2].flatten(0, 1) for part in (0, 1)]
    halves = [(part.mean(0), len(part)) for part in parts]

    @cache
    def smooth_halves(weight: float | None) -> tuple[float, tuple[torch.Tensor, torch.Tensor]]:
        """Return the squared error of both halves against each other, and the halves, by one method."""
        first, second = (_smooth(seen, count, weight) for seen, count in halves)
        errors = (first - halves[1][0]).square().sum() * halves[1][1] + (second - halves[0][0]).square().sum() * halves[0][1]
        return float(errors), (first, second)

    best = min((None, FIRST_WEIGHT), key=lambda weight: smooth_halves(weight)[0])
    tried = None
    while best is not None and best != tried:
        tried, number = best, WEIGHTS.index(best)
        best = min(WEIGHTS[max(number - 1, 0) : number + 2], key=lambda weight: smooth_halves(weight)[0])
    return Despeckled(_smooth(intensity.mean((0, 1)), looks, best), smooth_halves(best)[1], best)


def _smooth(intensity: torch.Tensor, looks: int, weight: float | None) -> torch.Tensor:
    """Despeckle the mean intensity (rows, columns) of some looks by total variation of a weight, or by the network."""
    if weight is not None:
        return smooth_by_total_variation(intensity, looks, weight)
    network, _ = load_network(DESPECKLER_WEIGHTS, kinds=("despeckler",))
    with torch.inference_mode():
        return network(intensity[None], torch.tensor([float(looks)]))[0].clone()
