"""Pixels and lines of a sensor that tell nothing of the light, found in a frame and replaced by their neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import median_filter

TAIL_DECADES = 5.0
"""How many decades beyond the frame's own number of pixels an exponential tail must be continued to reach a hot pixel."""

LINE_SIGMA = 12.0
"""Standard deviations, robustly estimated, of a line's mean from that of its neighbours."""

SAMPLED = 200_000
"""Pixels from which the tail and saturation are read."""


@dataclass(frozen=True)
class PixelFaults:
    """How many pixels and lines of a frame were replaced, and the share of its pixels that share the largest value."""

    hot_pixels: int = 0
    lines: int = 0
    saturated: float = 0.0


def repair(image: torch.Tensor) -> tuple[torch.Tensor, PixelFaults]:
    """Replace a frame's (H, W) hot pixels by the median around them, and dead or hot lines by the lines beside them."""
    image, hot = _replace_hot_pixels(image)
    image, lines = _replace_lines(image)
    sampled = _sampled(image)
    largest = sampled.max()
    at_largest = float((sampled == largest).mean()) if largest > sampled.min() else 0.0
    return image, PixelFaults(hot, lines, at_largest)


def _sampled(image: torch.Tensor) -> np.ndarray:
    """Pixels at even steps, (about `SAMPLED`,)."""
    return image.flatten()[:: max(1, image.numel() // SAMPLED)].cpu().numpy()


def _replace_hot_pixels(image: torch.Tensor) -> tuple[torch.Tensor, int]:
    """Speckle's brightest tail is exponential: the last decade of pixels tells where it ends."""
    sampled = _sampled(image)
    places = [int(share * len(sampled)) for share in (0.5, 0.99, 0.999)]
    middle, hundredth, thousandth = (float(value) for value in np.partition(sampled, places)[places])
    decade = max(thousandth - hundredth, (thousandth - middle) / 3.0)
    if decade <= 0.0:
        return image, 0
    limit = thousandth + decade * (np.log10(image.numel()) - 3.0 + TAIL_DECADES)
    if float(image.max()) <= limit:
        return image, 0
    hot = image > limit
    repaired = image.clone()
    height, width = image.shape
    for row, column in torch.nonzero(hot).tolist():
        rows, columns = slice(max(row - 2, 0), min(row + 3, height)), slice(max(column - 2, 0), min(column + 3, width))
        repaired[row, column] = image[rows, columns][~hot[rows, columns]].median() if not hot[rows, columns].all() else middle
    return repaired, int(hot.sum())


def _replace_lines(image: torch.Tensor) -> tuple[torch.Tensor, int]:
    """Rows and columns whose mean departs from their neighbours' by far more than such means do."""
    replaced = 0
    for axis in (0, 1):
        means = image.mean(1 - axis).cpu().numpy().astype(np.float64)
        apart = means - median_filter(means, 9, mode="nearest")
        spread = 1.4826 * float(np.median(np.abs(apart)))
        bad = np.abs(apart) > LINE_SIGMA * spread if spread > 0.0 else np.zeros(len(means), bool)
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
