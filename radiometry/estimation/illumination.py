"""A smooth illumination of frames, and ambient light as smooth: found, and divided out.

Speckle of a hidden object has contrast 1; what is smoother than any lag but zero can hold is no speckle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

MAX_MODES_PER_PATCH = 0.75
"""Half waves of a smooth illumination, at most, over the patches that fit along an axis: .375 lags."""

REFERENCE = 1.25
"""Half waves up to which those beyond tell how strong a half wave of mere speckle is."""

MIN_POWER_RATIO = 25.0
"""Power of a half wave over that of mere speckle from which the illumination is uneven: one frame in 40 000 by chance."""

ILLUMINATION_OFFSET = 0.1
"""Added to an illumination over its mean before frames are divided by it: where hardly any light falls, that would multiply
shot noise alone."""

MAX_ZERO_COUNT = 8
"""Of the polynomial, along an axis."""

BLOCKS, NEWTON_STEPS = 64, 30
"""Blocks of a frame along an axis, whose means an illumination is fitted to, and steps of the fit, none of which changes a
block by more than a factor of e."""

MIN_PIXEL_RATIO = -0.05
"""Of the mean, the least light of an eighth of a frame by an eighth; a dark frame may have taken more than there was."""


def is_uneven(image: torch.Tensor, patch: tuple[int, int]) -> bool:
    """Whether the illumination of a frame (H, W) stands out of its speckle; never said of light that is negative somewhere.

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
    """A frame (H, W) of uneven illumination as of an even one.

    What exceeds the illumination is divided by it, over its mean, plus FAINTEST: speckle as bright everywhere, but where there
    is hardly any light. The illumination is the exponential of a polynomial of as many zeros as half waves are much longer
    than a patch, too long for any lag but zero to hold them. A frame without light is left as it is.
    """
    mean = float(image.mean())
    if mean <= 0.0:
        return image
    illumination = _illumination(
        image / mean, [min(count, MAX_ZERO_COUNT) for count in _half_waves_over(image, patch, MAX_MODES_PER_PATCH)]
    )
    speckle = (image - mean * illumination) * ((1.0 + ILLUMINATION_OFFSET) / (illumination + ILLUMINATION_OFFSET))
    return speckle + (mean - speckle.mean())


def _half_waves_over(image: torch.Tensor, patch: tuple[int, int], share: float) -> list[int]:
    """Half waves down and right: a share of the patches that fit."""
    return [math.floor(share * length / size) for length, size in zip(image.shape, patch, strict=True)]


def _blocks(image: torch.Tensor, count: int) -> torch.Tensor:
    """Means of a frame's blocks, `count` along an axis or, where it has fewer, its pixels."""
    return torch.nn.functional.adaptive_avg_pool2d(image[None], [min(count, side) for side in image.shape])[0]


def _illumination(image: torch.Tensor, degrees: Sequence[int]) -> torch.Tensor:
    """Mean (H, W) of a frame (H, W) of mean 1: the exponential of a polynomial, fitted by Poisson's likelihood.

    That is consistent whatever the variance (Gourieroux, Monfort, Trognon, Econometrica 52, 701, 1984, doi:10.2307/1913472).
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
    """Legendre polynomials of 0, 1, ... degrees at the middles of an axis's pixels, (degree + 1, length)."""
    places = (np.arange(length) + 0.5) * (2.0 / length) - 1.0
    return torch.from_numpy(np.polynomial.legendre.legvander(places, degree).T.copy())


def _half_waves(count: int, length: int) -> torch.Tensor:
    """Orthonormal cosines of 0, 1, ... half waves over an axis, (count, length)."""
    phase = torch.arange(count)[:, None] * (torch.arange(length) + 0.5) * (math.pi / length)
    waves = torch.cos(phase) * math.sqrt(2.0 / length)
    waves[0] = math.sqrt(1.0 / length)
    return waves
