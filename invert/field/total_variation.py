"""Total variation of an albedo under the likelihood of several looks.

|E_j|^2 is exponentially distributed with mean r_j, so that the mean y of L looks has the negative log-likelihood L (log r + y / r)
(Goodman, Speckle Phenomena in Optics, section 4.3).
"""

from __future__ import annotations

import torch

STEPS = 150
"""Steps of the primal-dual iteration."""

MIN_LEVEL = 1e-3
"""Minimum albedo as a fraction of its scale."""

NEWTON_STEPS = 4
"""Newton steps of the proximal map of the likelihood."""


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
