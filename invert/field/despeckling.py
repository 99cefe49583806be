"""Albedo from the intensities of several fields: Gamma likelihood of the looks, total variation as prior.

|E_j|^2 is exponentially distributed with mean r_j, so that the mean y of L looks has the negative log-likelihood L (log r + y / r)
(Goodman, Speckle Phenomena in Optics, section 4.3). The weight of the total variation is that with the lowest squared error against
looks that the fit has not seen; their likelihood would be decided by the darkest cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from scipy import ndimage

from radiometry.ring_correlation import half_period

WEIGHTS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
"""Weights of the total variation, in nats per unit of the albedo's scale and pixel edge, that are tried."""

DEFAULT_WEIGHT = 2.0
"""Weight for a single frame, where no look can be held out."""

STEPS = 150
"""Steps of the primal-dual iteration."""

MIN_LEVEL = 1e-3
"""Minimum albedo as a fraction of its scale."""

DEVIATION_CELLS = 3.0
"""Standard deviation, in cells, of the Gaussian over which the squared difference between halves is averaged."""

NEWTON_STEPS = 4
"""Newton steps of the proximal map of the likelihood."""


@dataclass(frozen=True)
class Despeckled:
    """Albedo (rows, columns) in the unit of |E|^2; the two halves of the looks despeckled alike, None for one frame."""

    albedo: torch.Tensor
    halves: tuple[torch.Tensor, torch.Tensor] | None

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
    """Despeckle |E|^2 (frames, modes, rows, columns), with the weight that predicts held-out frames best."""
    looks = intensity.shape[0] * intensity.shape[1]
    if len(intensity) == 1:
        return Despeckled(smooth_by_total_variation(intensity.mean((0, 1)), looks, DEFAULT_WEIGHT), None)
    parts = [intensity[part::2].flatten(0, 1) for part in (0, 1)]
    halves = [(part.mean(0), len(part)) for part in parts]

    @cache
    def smooth_halves(number: int) -> tuple[float, tuple[torch.Tensor, torch.Tensor]]:
        """Return the squared error of both halves against each other, and the halves, with one of the weights."""
        first, second = (smooth_by_total_variation(seen, count, WEIGHTS[number]) for seen, count in halves)
        errors = (first - halves[1][0]).square().sum() * halves[1][1] + (second - halves[0][0]).square().sum() * halves[0][1]
        return float(errors), (first, second)

    best, tried = None, WEIGHTS.index(DEFAULT_WEIGHT)
    while best != tried:
        best = tried
        near = range(max(best - 1, 0), min(best + 2, len(WEIGHTS)))
        tried = min(near, key=lambda number: smooth_halves(number)[0])
    return Despeckled(smooth_by_total_variation(intensity.mean((0, 1)), looks, WEIGHTS[best]), smooth_halves(best)[1])


def smooth_by_total_variation(intensity: torch.Tensor, looks: int, weight: float) -> torch.Tensor:
    """Minimise looks (log r + y / r) + weight TV(r) over r by the primal-dual algorithm of Chambolle and Pock
    (doi:10.1007/s10851-010-0251-1).

    Args:
        intensity: mean y of the looks (rows, columns).
    """
    scale = float((intensity.square().sum() / intensity.sum()).clamp_min(1e-30)) * 0.5
    seen = (intensity / scale).clamp_min(MIN_LEVEL)
    albedo = torch.nn.functional.avg_pool2d(seen[None], 5, 1, 2, count_include_pad=False)[0]
    ahead, dual = albedo.clone(), seen.new_zeros(2, *seen.shape)
    step = 8.0**-0.5
    for _ in range(STEPS):
        dual += step * _differences(ahead)
        dual /= (dual.square().sum(0).sqrt() / weight).clamp_min(1.0)
        moved = _likelihood_map(albedo + step * _divergence(dual), seen, step * looks)
        ahead = 2.0 * moved - albedo
        albedo = moved
    return albedo * scale


def _likelihood_map(point: torch.Tensor, seen: torch.Tensor, step: float) -> torch.Tensor:
    """Return the proximal map of step (log r + y / r): the root of r^3 - x r^2 + step (r - y) = 0 near max(x, y)."""
    root = torch.maximum(point, seen).clamp_min(MIN_LEVEL)
    for _ in range(NEWTON_STEPS):
        value = ((root - point) * root + step) * root - step * seen
        slope = (3.0 * root - 2.0 * point) * root + step
        root = (root - value / slope.clamp_min(1e-6)).clamp_min(MIN_LEVEL)
    return root


def _differences(image: torch.Tensor) -> torch.Tensor:
    found = image.new_zeros(2, *image.shape)
    found[0, :-1] = image[1:] - image[:-1]
    found[1, :, :-1] = image[:, 1:] - image[:, :-1]
    return found


def _divergence(pair: torch.Tensor) -> torch.Tensor:
    """Return minus the adjoint of `_differences`."""
    down, right = pair[0].clone(), pair[1].clone()
    down[1:] -= pair[0, :-1]
    right[:, 1:] -= pair[1, :, :-1]
    return down + right
