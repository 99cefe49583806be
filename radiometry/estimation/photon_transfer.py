"""Gain of a camera from its frames: the slope of the noise's variance over the light (photon transfer).

Shot noise, whose variance is g I at the intensity I, contributes to the third moment of a frame; read noise does not. The
floor of an estimate cannot distinguish the two, but the slope of the variance over the intensity does. Blocks of 2 x 2
pixels are compared with the mean of the 12 pixels around them, the ring: g = cov(ring, d^2) / cov(ring, mean), where d is
half the difference between the two diagonal sums of a block, which smooth light hardly changes. The noise of the ring is
independent of that of the block, so that neither covariance has an offset by noise (instrumental variable).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

STRIP_ROWS = 64
"""Rows of a frame that are processed at once, so that they stay in the cache."""

MAX_VARIANCE_RATIO = 1.2
"""Maximum variance of the pixels' noise in units of the floor of the estimate; above it, neighbouring pixels differ by speckle."""


class PhotonTransfer(NamedTuple):
    """Noise of the pixels of a frame.

    Attributes:
        gain: slope of the variance over the light, in frame units; electrons per frame unit is its reciprocal.
        error: standard error of the gain; infinite if the light does not vary.
        variance: mean variance of a pixel's noise.
    """

    gain: float
    error: float
    variance: float


def photon_transfer(image: torch.Tensor) -> PhotonTransfer:
    """Measure the gain of a frame (H, W) of at least 6 x 6 pixels, whose grains are wider than two pixels."""
    height, width = (2 * (side // 2) for side in image.shape)
    level, (lowest, highest) = float(image.mean()), torch.aminmax(image)
    unit = float(highest - lowest) or 1.0  # single precision suffices once level and unit are taken out
    strips = [
        _blocks((image[top : min(top + STRIP_ROWS + 4, height), :width] - level) / unit)
        for top in range(0, height - 4, STRIP_ROWS)
    ]
    ring, light, square = (torch.cat(parts) for parts in zip(*strips, strict=True))
    variance = float(square.mean()) * unit**2
    ring, light, noise = (one - one.mean() for one in (ring, light, square))
    slope = _mean_product(ring, light)
    if slope <= 0.0:
        return PhotonTransfer(0.0, np.inf, variance)
    gain = _mean_product(ring, noise) / slope
    scatter = ring.mul_(noise.sub_(light, alpha=gain))
    error = (_mean_product(scatter, scatter) / scatter.numel()) ** 0.5 / slope
    return PhotonTransfer(gain * unit, error * unit, variance)


def _blocks(pixels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the mean around each block of 2 x 2 pixels, the mean of the block, and its squared diagonal difference."""
    upper, lower = pixels[2:-2:2], pixels[3:-2:2]
    down, across = upper + lower, upper - lower
    total = down[:, 2:-2:2] + down[:, 3:-2:2]
    square = (0.5 * (across[:, 2:-2:2] - across[:, 3:-2:2])).square()
    rows = down + pixels[1:-4:2] + pixels[4::2]  # the rows of a block and those beside them
    pairs = rows[:, 1:-2:2] + rows[:, 2::2]
    return (pairs[:, :-1] + pairs[:, 1:] - total) / 12.0, 0.25 * total, square


def _mean_product(first: torch.Tensor, second: torch.Tensor) -> float:
    return float(torch.dot(first.flatten(), second.flatten())) / first.numel()


def combine(found: Sequence[PhotonTransfer]) -> PhotonTransfer:
    """Return the mean gain of several frames, weighted by inverse squared errors, its error, and the mean variance of the
    noise.
    """
    known = [one for one in found if np.isfinite(one.error) and one.error > 0.0]
    variance = float(np.mean([one.variance for one in found])) if found else 0.0
    if not known:
        return PhotonTransfer(0.0, np.inf, variance)
    weights = np.array([one.error**-2.0 for one in known])
    gain = float(weights @ [one.gain for one in known] / weights.sum())
    return PhotonTransfer(gain, float(weights.sum() ** -0.5), variance)


def shot_noise(found: PhotonTransfer, level: float, floor: float) -> PhotonTransfer:
    """Return the gain and its error, with `variance` replaced by that of the shot noise alone.

    If the error of the gain exceeds floor / level, half of the floor counts as shot noise, with an error of the same size.
    Grains as small as a pixel raise the variance between neighbours above the floor; all of the floor is then taken for shot
    noise.

    Args:
        level: mean of the frames. floor: noise floor of the estimate: variance of all noise per pixel, in frame units squared.
    """
    largest = floor / level if level > 0.0 else 0.0
    if found.variance > MAX_VARIANCE_RATIO * floor:
        return PhotonTransfer(largest, 0.0, floor)
    has_offset = found.gain - 3.0 * found.error > largest  # the level is not that of the light
    if found.error > largest and not has_offset:
        return PhotonTransfer(0.5 * largest, 0.5 * largest, 0.5 * floor)
    gain = max(found.gain, 0.0)
    return PhotonTransfer(gain, found.error, min(gain * level, floor))
