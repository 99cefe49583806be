"""Detection and replacement of defective pixels, rows and columns, and of specular highlights; saturation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import median_filter
from scipy.stats import norm

from radiometry.estimation.hot_pixels import replace_hot_pixels, subsample

LINE_SIGMA = 9.0
"""Minimum deviation, in standard deviations, of the mean of a defective line from the median of its nine neighbours;
speckle reaches 6. The deviation is derived from the 95 % quantile of all differences, because most are zero for wide
grains, and is at least a twelfth of the median deviation of the means of all lines."""

SATURATION_FALSE_ALARMS = 1e-4
"""Probability that a frame that is not saturated is reported as saturated."""


@dataclass(frozen=True)
class PixelFaults:
    """Numbers of pixels and lines of a frame that were replaced, and fraction of its pixels with the maximum value."""

    hot_pixels: int = 0
    lines: int = 0
    saturated: float = 0.0


def repair(image: torch.Tensor) -> tuple[torch.Tensor, PixelFaults]:
    """Replace hot pixels of a frame (H, W) by the median around them, and defective lines by their neighbours."""
    image, hot = replace_hot_pixels(image)
    image, lines = _replace_lines(image)
    return image, PixelFaults(hot, lines, _saturated_fraction(subsample(image)))


def _saturated_fraction(sampled: np.ndarray) -> float:
    """Return the fraction of pixels with the maximum value; zero unless significantly more pixels have it than have the next
    lower value.

    Without saturation, fewer pixels have a higher value. Saturation adds all brighter pixels to those at the maximum.
    """
    _, counts = np.unique(sampled, return_counts=True)
    if len(counts) < 2:
        return 0.0
    below, largest = map(float, counts[-2:])
    is_excess = largest - below > norm.isf(SATURATION_FALSE_ALARMS) * math.sqrt(largest + below)
    return largest / len(sampled) if is_excess else 0.0


def _smallest_step(sampled: np.ndarray) -> float:
    """Return the smallest nonzero difference between pixel values, which is one count in a dim frame; 0 if all are equal."""
    steps = np.diff(np.unique(sampled))
    return float(steps.min()) if len(steps) else 0.0


def _replace_lines(image: torch.Tensor) -> tuple[torch.Tensor, int]:
    """Replace rows and columns whose mean differs from that of their neighbours much more than the means of other lines do."""
    replaced, step = 0, _smallest_step(subsample(image))
    for axis in (0, 1):
        means = image.mean(1 - axis).cpu().numpy().astype(np.float64)
        apart = means - median_filter(means, 9, mode="nearest")
        spread = float(np.quantile(np.abs(apart), 0.95)) / 1.96
        spread = max(spread, float(np.median(np.abs(means - np.median(means)))) / 12.0)
        # Sums of few counts have a wider tail than a Gaussian (Bernstein's inequality).
        by_count = LINE_SIGMA**2 * step / image.shape[1 - axis] / 6.0
        bad = (
            np.abs(apart) > by_count + math.hypot(by_count, LINE_SIGMA * spread) if spread > 0.0 else np.zeros(len(means), bool)
        )
        if not bad.any() or bad.mean() > 0.02:
            continue
        good = np.flatnonzero(~bad)
        if not replaced:
            image = image.clone()
        lines = image if axis == 0 else image.T
        for line in np.flatnonzero(bad):
            lines[line] = lines[good[np.abs(good - line).argmin()]]
        replaced += int(bad.sum())
    return image, replaced
