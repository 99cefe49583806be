"""Values measured on one frame of a live capture: light, contrast, grain and saturation."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import torch

from radiometry.estimation.photon_transfer import PhotonTransfer, combine, photon_transfer

FIELD = 512
"""Side in pixels of the middle of a frame in which grain and gain are measured."""


@dataclass(frozen=True)
class FrameReport:
    """Values measured on one frame.

    Attributes:
        mean: in frame units.
        photoelectrons: mean photoelectrons per pixel, by the gain that the slope of variance over mean reveals; None while
            the gain is uncertain.
        contrast: standard deviation of the speckle over its mean, from the covariance of neighbouring pixels.
        grain_pixels: full width at half maximum of the speckle's covariance, in pixels.
        saturated: fraction of the pixels that equal the maximum of the frame; 0 if it is at most 0.001.
    """

    mean: float
    photoelectrons: float | None
    contrast: float
    grain_pixels: float
    saturated: float


def measure_frame(image: np.ndarray, raw: np.ndarray, gains: deque[PhotonTransfer]) -> FrameReport:
    """Measure a corrected frame; whether pixels are saturated shows in the frame as it arrived.

    Args:
        gains: gains by the latest frames, to which that of this one is added.
    """
    top, left = (max(0, (side - FIELD) // 2) for side in image.shape)
    middle = image[top : top + FIELD, left : left + FIELD]
    gains.append(photon_transfer(torch.from_numpy(np.ascontiguousarray(middle))))
    found = combine(gains)
    mean, highest = float(image.mean()), float(raw.max())
    at_top = float((raw >= highest).mean()) if highest > 0.0 else 0.0
    line = covariance_line(middle)
    return FrameReport(
        mean,
        mean / found.gain if found.gain > 3.0 * found.error else None,
        math.sqrt(max(0.0, line[1])) / mean if mean > 0.0 else 0.0,
        grain_width(line),
        at_top if at_top > 1e-3 else 0.0,
    )


def covariance_line(image: np.ndarray) -> np.ndarray:
    """Return the covariance of a frame (H, W) at 0, 1, 2 ... pixels, averaged over both axes. Noise that is independent
    between pixels affects only the value at 0 pixels.
    """
    spectrum = np.abs(np.fft.rfft2(image - image.mean())) ** 2
    covariance = np.fft.irfft2(spectrum, image.shape) / image.size
    half = min(image.shape) // 2
    return 0.5 * (covariance[0, :half] + covariance[:half, 0])


def grain_width(line: np.ndarray) -> float:
    """Return the width at half maximum, in pixels, at which a covariance (`covariance_line`) falls to half of its value at
    one pixel. The value at 0 is ignored, because it contains noise.
    """
    if line[1] <= 0.0:
        return 1.0
    below = np.nonzero(line[1:] < 0.5 * line[1])[0]
    return 2.0 * float(below[0] + 1) if len(below) else float(len(line))
