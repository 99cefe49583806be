"""What of frames is no speckle: a smooth illumination, and a pattern that stays while the speckle changes.

Speckle of a hidden object has contrast 1 and changes from frame to frame. Vignetting and ambient light are smooth; a textured
wall, fringes and the sensor's own pattern stay, and show as power that the frames share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from scipy.ndimage import binary_dilation, uniform_filter

from radiometry.autocorrelation import LAGS

SMOOTH = 0.75
"""Half waves of a smooth illumination, at most, over the patches that fit along an axis: .375 lags."""

REFERENCE = 1.25
"""Half waves up to which those beyond tell how strong a half wave of mere speckle is."""

UNEVEN = 25.0
"""Power of a half wave over that of mere speckle from which the illumination is uneven: one frame in 40 000 by chance."""

FAINTEST = 0.1
"""Added to an illumination over its mean before frames are divided by it: where hardly any light falls, that would multiply
shot noise alone."""

MOST_ZEROS = 8
"""Of the polynomial, along an axis."""

BLOCKS, NEWTON_STEPS = 64, 30
"""Blocks of a frame along an axis, whose means an illumination is fitted to, and steps of the fit, none of which changes a
block by more than a factor of e."""

SHARED = 4.5
"""Standard deviations of the power that frames share from which there is a fixed pattern."""

_BLOCK = 5
_BLOCK_DEVIATION = 0.262
"""Standard deviation of the mean of 5 x 5 lags over that of one: (1 + 2 sum (1 - n / 5) rho_n) / 5, rho_n = .152 / n^2."""

_SUM_DEVIATION = 1.5
"""That of the sum of many lags over that of as many independent ones: 1 + 2 sum rho_n."""

_RING = np.maximum(*np.abs(np.mgrid[-LAGS : LAGS + 1, -LAGS : LAGS + 1]))
_LARGEST_SHIFT = 32


def flatten(image: torch.Tensor, patch: tuple[int, int], uneven: bool | None = None) -> tuple[torch.Tensor, bool]:
    """Even out the illumination of a frame (H, W) where it is uneven; and whether that was done.

    What exceeds the illumination is divided by it, over its mean, plus FAINTEST: speckle as bright everywhere, but where there
    is hardly any light. The illumination is the exponential of a polynomial of as many zeros as half waves are much longer
    than a patch, too long for any lag but zero to hold them. A frame whose light is negative somewhere is left alone.

    Args:
        uneven: whether it is, if that is known: frames of one capture are treated alike, or what they share would not cancel.
    """
    sides = [length / size for length, size in zip(image.shape, patch, strict=True)]
    smooth, all_waves = ([math.floor(share * side) for side in sides] for share in (SMOOTH, REFERENCE))
    if uneven is False or min(smooth) < 1 or all_waves == smooth:
        return image, False
    down, right = (_half_waves(count + 1, length).to(image) for count, length in zip(all_waves, image.shape, strict=True))
    waves = down @ image @ right.T
    kept = torch.zeros_like(waves, dtype=torch.bool)
    kept[: smooth[0] + 1, : smooth[1] + 1] = True
    reference = float(waves[~kept].square().mean())
    mean = float(waves[0, 0]) / math.sqrt(image.numel())
    waves[0, 0] = 0.0
    if mean <= 0.0 or (uneven is None and float(waves[kept].square().max()) <= UNEVEN * reference):
        return image, False
    coarse = torch.nn.functional.adaptive_avg_pool2d(image[None], 8)
    if float(coarse.min()) < -0.05 * mean:
        return image, False
    illumination = _illumination(image / mean, [min(degree, MOST_ZEROS) for degree in smooth])
    speckle = (image - mean * illumination) * ((1.0 + FAINTEST) / (illumination + FAINTEST))
    return speckle + (mean - speckle.mean()), True


def _illumination(image: torch.Tensor, degrees: Sequence[int]) -> torch.Tensor:
    """Mean (H, W) of a frame (H, W) of mean 1: the exponential of a polynomial, fitted by Poisson's likelihood.

    That is consistent whatever the variance (Gourieroux, Monfort, Trognon, Econometrica 52, 701, 1984, doi:10.2307/1913472).
    """
    blocks = torch.nn.functional.adaptive_avg_pool2d(image[None], [min(BLOCKS, side) for side in image.shape])[0].double()
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


def shared_lags(shared: np.ndarray, power: np.ndarray, dof: float) -> np.ndarray:
    """Lags at which frames share power: one by one, in blocks, or over the rings around zero lag; bool (127, 127).

    Args:
        shared: real part of the frames' cross-spectrum. power: that of the frames, in the same unit.
        dof: K of `shared`, whose variance is power^2 / K without a fixed pattern.
    """
    sigma = np.divide(shared * math.sqrt(dof), power, out=np.zeros_like(shared), where=power > 0.0)
    sigma[LAGS, LAGS] = 0.0
    chosen = binary_dilation(sigma > SHARED, np.ones((3, 3), bool))
    chosen |= binary_dilation(uniform_filter(sigma, _BLOCK, mode="nearest") > SHARED * _BLOCK_DEVIATION, np.ones((3, 3), bool))
    for ring in (2, 4, 8, 16, 32, LAGS):
        inside = ring >= _RING
        # Both signs of a lag hold the same.
        if sigma[inside].sum() > SHARED * _SUM_DEVIATION * math.sqrt(2.0 * inside.sum()):
            chosen |= inside
    return chosen


def shift_between(first: torch.Tensor, other: torch.Tensor, shape: tuple[int, int]) -> tuple[float, float]:
    """Pixels (down, right) by which what two frames share has moved from the first to the other, to a part of a pixel.

    Args:
        first, other: their spectra (rows, columns // 2 + 1) on a grid of `shape`.
    """
    cross = torch.fft.irfft2(first.conj() * other, s=shape)
    reach = min(_LARGEST_SHIFT, min(shape) // 4)
    near = torch.roll(cross, (reach, reach), (0, 1))[: 2 * reach + 1, : 2 * reach + 1].cpu().numpy()
    peak = np.array(np.unravel_index(near.argmax(), near.shape))
    finer = []
    for axis, middle in enumerate(peak):
        if not 0 < middle < 2 * reach:
            return 0.0, 0.0
        before, here, after = (near[tuple(peak + step * np.eye(2, dtype=int)[axis])] for step in (-1, 0, 1))
        bend = float(before - 2.0 * here + after)
        finer.append(float(middle) - reach + (0.5 * float(before - after) / bend if bend < 0.0 else 0.0))
    return finer[0], finer[1]
