"""Smooth illumination, by the laser or by a lamp: detection and correction.

Speckle of a hidden object has contrast 1. Structure that is smoother than every lag except zero is therefore not speckle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

MAX_MODES_PER_PATCH = 0.75
"""Highest frequency of the illumination model in half waves per patch; 0.75 corresponds to a lag of 0.375."""

REFERENCE = 1.25
"""Highest frequency, in half waves per patch, of the modes beyond the illumination model that measure the power of speckle."""

MIN_POWER_RATIO = 25.0
"""Minimum power of a cosine mode in units of that of speckle for a non-uniform illumination; by chance once in 40 000 frames."""

ILLUMINATION_OFFSET = 0.1
"""Offset added to the relative illumination before division; without it, dark regions would amplify shot noise."""

MAX_ZERO_COUNT = 8
"""Maximum number of zeros of the polynomial along an axis."""

BLOCKS, NEWTON_STEPS = 64, 30
"""Blocks of a frame along an axis, to whose means the illumination is fitted, and maximum number of Newton steps; a step
changes a block by at most a factor of e."""

MIN_PIXEL_RATIO = -0.05
"""Minimum mean of an eighth by an eighth of a frame, in units of the mean; dark frames can make it negative."""


def is_uneven(image: torch.Tensor, patch: tuple[int, int]) -> bool:
    """Return whether uneven illumination of a frame (H, W) exceeds its speckle; False if the mean of a block is clearly negative.

    Args:
        patch: rows and columns of a patch.
    """
    smooth, all_waves = (_half_waves_over(image, patch, share) for share in (MAX_MODES_PER_PATCH, REFERENCE))
    mean = float(image.mean())
    if min(smooth) < 1 or all_waves == smooth or mean <= 0.0:
        return False
    down, right = (_half_waves(count + 1, length).to(image) for count, length in zip(all_waves, image.shape, strict=True))
    power = (down @ image @ right.T).square()
    kept = torch.zeros_like(power, dtype=torch.bool)
    kept[: smooth[0] + 1, : smooth[1] + 1] = True
    reference = float(power[~kept].mean())
    power[0, 0] = 0.0
    return float(power[kept].max()) > MIN_POWER_RATIO * reference and float(_blocks(image, 8).min()) >= MIN_PIXEL_RATIO * mean


def flatten_illumination(image: torch.Tensor, patch: tuple[int, int]) -> torch.Tensor:
    """Correct a frame (H, W) for smooth illumination.

    The deviation from the illumination is divided by the relative illumination plus ILLUMINATION_OFFSET, so that the speckle
    is equally bright everywhere except where there is hardly any light. The illumination is the exponential of a polynomial
    that varies so slowly over a patch that it affects zero lag only. A frame without light remains unchanged.
    """
    mean = float(image.mean())
    if mean <= 0.0:
        return image
    illumination = relative_illumination(image, patch)
    speckle = (image - mean * illumination) * ((1.0 + ILLUMINATION_OFFSET) / (illumination + ILLUMINATION_OFFSET))
    return speckle + (mean - speckle.mean())


def relative_illumination(image: torch.Tensor, patch: tuple[int, int]) -> torch.Tensor:
    """Return the smooth illumination of a frame (H, W), mean 1; 1 everywhere for a frame without light."""
    mean = float(image.mean())
    if mean <= 0.0:
        return torch.ones_like(image)
    counts = _half_waves_over(image, patch, MAX_MODES_PER_PATCH)
    return _illumination(image / mean, [min(count, MAX_ZERO_COUNT) for count in counts])


def _half_waves_over(image: torch.Tensor, patch: tuple[int, int], share: float) -> list[int]:
    """Return the highest numbers of half waves of a cosine mode along rows and columns: `share` times the number of patches
    along that axis, rounded down.
    """
    return [math.floor(share * length / size) for length, size in zip(image.shape, patch, strict=True)]


def _blocks(image: torch.Tensor, count: int) -> torch.Tensor:
    """Return the means of the blocks of a frame, `count` along an axis or, at most, one per pixel."""
    return torch.nn.functional.adaptive_avg_pool2d(image[None], [min(count, side) for side in image.shape])[0]


def _illumination(image: torch.Tensor, degrees: Sequence[int]) -> torch.Tensor:
    """Fit the mean (H, W) of a frame (H, W) of mean 1 by the exponential of a polynomial, with the Poisson likelihood.

    The fit is consistent for any variance (Gourieroux, Monfort, Trognon, Econometrica 52, 701, 1984, doi:10.2307/1913472).
    """
    blocks = _blocks(image, BLOCKS).double()
    coarse = [_polynomials(degree, side) for degree, side in zip(degrees, blocks.shape, strict=True)]
    basis = torch.einsum("iy,jx->yxij", *coarse).flatten(2).flatten(0, 1).to(blocks)
    seen, weights = blocks.flatten().clamp_min(0.0), basis.new_zeros(basis.shape[1])
    for _ in range(NEWTON_STEPS):
        fitted = (basis @ weights).exp()
        curvature = basis.T @ (fitted[:, None] * basis) + 1e-6 * torch.eye(len(weights)).to(basis)
        step = torch.linalg.solve(curvature, basis.T @ (seen - fitted))
        weights += step / (basis @ step).abs().max().clamp_min(1.0)
    down, right = (_polynomials(degree, side).to(weights) for degree, side in zip(degrees, image.shape, strict=True))
    fitted = (down.T @ weights.reshape(len(down), len(right)) @ right).exp()
    return (fitted / fitted.mean()).to(image)


def _polynomials(degree: int, length: int) -> torch.Tensor:
    """Return Legendre polynomials of degrees 0, 1, ... at the pixel centres of an axis, (degree + 1, length)."""
    places = (np.arange(length) + 0.5) * (2.0 / length) - 1.0
    return torch.from_numpy(np.polynomial.legendre.legvander(places, degree).T.copy())


def _half_waves(count: int, length: int) -> torch.Tensor:
    """Return orthonormal cosines of 0, 1, ... half waves over an axis, (count, length)."""
    phase = torch.arange(count)[:, None] * (torch.arange(length) + 0.5) * (math.pi / length)
    waves = torch.cos(phase) * math.sqrt(2.0 / length)
    waves[0] = math.sqrt(1.0 / length)
    return waves
