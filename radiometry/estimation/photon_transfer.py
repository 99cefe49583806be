"""Gain of a camera from its frames: the slope of the noise's variance over the light (photon transfer).

Shot noise of variance g I at the light I multiplies the third moment of a frame; read noise does not. The floor of an estimate does not
tell one from the other, the slope does. Blocks of 2 x 2 pixels are compared with the 12 pixels around them:
g = cov(ring, d^2) / cov(ring, mean), where d is the diagonal difference of a block, of which light changes little. The noise of the ring
is independent of that of the block, so that neither covariance has an offset by noise (instrumental variable).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

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
    pixels = image[:height, :width].double()
    corners = [pixels[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    total = corners[0] + corners[1] + corners[2] + corners[3]
    square = (0.5 * (corners[0] - corners[1] - corners[2] + corners[3])).square()[1:-1, 1:-1]
    mean = 0.25 * total[1:-1, 1:-1]
    near = torch.nn.functional.avg_pool2d(pixels[1:-1, 1:-1][None, None], 4, 2)[0, 0]
    ring = (16.0 * near - total[1:-1, 1:-1]) / 12.0
    ring, light, noise = (one - one.mean() for one in (ring, mean, square))
    slope = float((ring * light).mean())
    if slope <= 0.0:
        return PhotonTransfer(0.0, np.inf, float(square.mean()))
    gain = float((ring * noise).mean()) / slope
    error = float((ring * (noise - gain * light)).std()) / slope / ring.numel() ** 0.5
    return PhotonTransfer(gain, error, float(square.mean()))


def combine(found: Sequence[PhotonTransfer]) -> PhotonTransfer:
    """Return the gain of several frames, weighted by the inverse squares of their errors."""
    known = [one for one in found if np.isfinite(one.error) and one.error > 0.0]
    variance = float(np.mean([one.variance for one in found])) if found else 0.0
    if not known:
        return PhotonTransfer(0.0, np.inf, variance)
    weights = np.array([one.error**-2.0 for one in known])
    gain = float(weights @ [one.gain for one in known] / weights.sum())
    return PhotonTransfer(gain, float(weights.sum() ** -0.5), variance)


def shot_noise(found: PhotonTransfer, level: float, floor: float) -> PhotonTransfer:
    """Return the gain with its error, and as its variance that of the shot noise alone.

    Where the gain is not known to the fraction floor / level, the shot noise may be anything from none to the floor. Grains as small as a
    pixel raise the variance between neighbours above the floor; all of the floor is then taken for shot noise.

    Args:
        level: mean of the frames. floor: variance of all noise, from the autocorrelation.
    """
    largest = floor / level if level > 0.0 else 0.0
    if found.variance > MAX_VARIANCE_RATIO * floor:
        return PhotonTransfer(largest, 0.0, floor)
    has_offset = found.gain - 3.0 * found.error > largest  # the level is not that of the light
    if found.error > largest and not has_offset:
        return PhotonTransfer(0.5 * largest, 0.5 * largest, 0.5 * floor)
    gain = max(found.gain, 0.0)
    return PhotonTransfer(gain, found.error, min(gain * level, floor))
