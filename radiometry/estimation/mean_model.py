"""What of frames is no speckle: a smooth illumination, and a pattern that stays while the speckle changes.

Speckle of a hidden object has contrast 1 and changes from frame to frame. Vignetting and ambient light are smooth; a textured
wall, fringes and the sensor's own pattern stay, and show as power that the frames share.
"""

from __future__ import annotations

import math

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
"""Least of a fitted illumination over its mean."""

SHARED = 4.5
"""Standard deviations of the power that frames share from which there is a fixed pattern."""

_BLOCK = 5
_BLOCK_DEVIATION = 0.262
"""Standard deviation of the mean of 5 x 5 lags over that of one: (1 + 2 sum (1 - n / 5) rho_n) / 5, rho_n = .152 / n^2."""

_SUM_DEVIATION = 1.5
"""That of the sum of many lags over that of as many independent ones: 1 + 2 sum rho_n."""

_RING = np.maximum(*np.abs(np.mgrid[-LAGS : LAGS + 1, -LAGS : LAGS + 1]))
_LARGEST_SHIFT = 32


def flatten(image: torch.Tensor, patch: tuple[int, int]) -> tuple[torch.Tensor, bool]:
    """Divide a frame (H, W) by its illumination, of mean 1, where that is uneven; and whether it is.

    The illumination is a sum of half waves (a discrete cosine transform, cut off) much longer than a patch: too long for any
    lag but zero to hold them.
    """
    sides = [length / size for length, size in zip(image.shape, patch, strict=True)]
    smooth, all_waves = ([math.floor(share * side) for side in sides] for share in (SMOOTH, REFERENCE))
    if min(smooth) < 1 or all_waves == smooth:
        return image, False
    down, right = (_half_waves(count + 1, length).to(image) for count, length in zip(all_waves, image.shape, strict=True))
    waves = down @ image @ right.T
    kept = torch.zeros_like(waves, dtype=torch.bool)
    kept[: smooth[0] + 1, : smooth[1] + 1] = True
    reference = float(waves[~kept].square().mean())
    mean = float(waves[0, 0])
    waves[0, 0] = 0.0
    if mean <= 0.0 or float(waves[kept].square().max()) <= UNEVEN * reference:
        return image, False
    illumination = down.T @ (waves * kept) @ right * (math.sqrt(image.numel()) / mean) + 1.0
    return image / illumination.clamp_min(FAINTEST), True


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
