"""Detection and replacement of defective pixels, rows and columns, and of specular highlights."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import find_objects, label, median_filter
from scipy.stats import norm

TAIL_DECADES = 5.0
"""Decades below a frequency of one pixel per frame to which the exponential tail is extrapolated; brighter pixels are hot."""

LINE_SIGMA = 9.0
"""Minimum deviation, in standard deviations, of the mean of a defective line from the median of its nine neighbours;
speckle reaches 6. The deviation is derived from the 95 % quantile of all differences, because most are zero for wide
grains, and is at least a twelfth of the median deviation of the means of all lines."""

GLINT_PIXELS = 9
"""Minimum number of adjacent hot pixels that form a specular highlight, whose light fades into the speckle around it."""

MIN_PHOTONS, PHOTON_SPREAD = 20, 0.3
"""Minimum number of bright pixels that may be single photons, and maximum distance of the quartiles of their values relative to
their median above the dark level."""

SATURATION_FALSE_ALARMS = 1e-4
"""Probability that a frame that is not saturated is reported as saturated."""

MAX_SAMPLED_PIXELS = 200_000
"""Number of pixels from which the tail and the saturation are read."""


@dataclass(frozen=True)
class PixelFaults:
    """Numbers of pixels and lines of a frame that were replaced, and fraction of its pixels with the maximum value."""

    hot_pixels: int = 0
    lines: int = 0
    saturated: float = 0.0


def repair(image: torch.Tensor) -> tuple[torch.Tensor, PixelFaults]:
    """Replace hot pixels of a frame (H, W) by the median around them, and defective lines by their neighbours."""
    image, hot = _replace_hot_pixels(image)
    image, lines = _replace_lines(image)
    return image, PixelFaults(hot, lines, _saturated_fraction(_subsample(image)))


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


def _subsample(image: torch.Tensor) -> np.ndarray:
    """Return pixels at equal steps, about `MAX_SAMPLED_PIXELS` of them."""
    return image.flatten()[:: max(1, image.numel() // MAX_SAMPLED_PIXELS)].cpu().numpy()


def _smallest_step(sampled: np.ndarray) -> float:
    """Return the smallest nonzero difference between pixel values, which is one count in a dim frame; 0 if all are equal."""
    steps = np.diff(np.unique(sampled))
    return float(steps.min()) if len(steps) else 0.0


def _replace_hot_pixels(image: torch.Tensor) -> tuple[torch.Tensor, int]:
    """Replace, by the local median, pixels brighter than speckle can be. The exponential tail of its histogram is
    extrapolated from the brightest percent.
    """
    sampled = np.sort(_subsample(image))
    middle, hundredth, thousandth = (float(sampled[int(share * len(sampled))]) for share in (0.5, 0.99, 0.999))
    # Counts of a few photons have few values, so the fraction that reaches one of them is not that of the quantile.
    decades = [-math.log10(1.0 - np.searchsorted(sampled, value) / len(sampled)) for value in (middle, hundredth, thousandth)]
    rises = [
        (thousandth - value) / (decades[2] - above)
        for value, above in zip((middle, hundredth), decades, strict=False)
        if thousandth > value
    ]
    if not rises:
        return image, 0
    limit = thousandth + max(rises) * (math.log10(image.numel()) - decades[2] + TAIL_DECADES)
    if float(image.max()) <= limit:
        return image, 0
    hot = image > limit
    if _are_single_photons(image[hot].cpu().numpy(), middle):
        return image, 0
    repaired = _replace_highlights(image, hot, hundredth)
    height, width = image.shape
    for row, column in torch.nonzero(hot & (repaired > limit)).tolist():
        rows, columns = slice(max(row - 2, 0), min(row + 3, height)), slice(max(column - 2, 0), min(column + 3, width))
        whole = ~hot[rows, columns]
        repaired[row, column] = repaired[rows, columns][whole].median() if whole.any() else middle
    return repaired, int(hot.sum())


def _are_single_photons(values: np.ndarray, dark: float) -> bool:
    """Return whether many bright pixels share one value up to weak read noise, as single photons in a dim frame do.

    Hot pixels have many values, or exactly one if they are saturated.

    Args:
        values: pixels above the limit. dark: median of the frame.
    """
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
    return len(values) >= MIN_PHOTONS and 0.0 < high - low < PHOTON_SPREAD * (middle - dark)


def _replace_highlights(image: torch.Tensor, hot: torch.Tensor, bright: float) -> torch.Tensor:
    """Replace a disc around each cluster of hot pixels by the mean of the other pixels. The disc grows until the mean of the
    ring around it is at most `bright`.
    """
    repaired, mean = image.clone(), image[~hot].mean()
    labels, _ = label(hot.cpu().numpy())
    for number, place in enumerate(find_objects(labels), 1):
        pixels, across = int((labels[place] == number).sum()), max(side.stop - side.start for side in place)
        if pixels < max(GLINT_PIXELS, 0.5 * across**2):  # too few pixels, or a line
            continue
        middle, reach = [0.5 * (side.start + side.stop - 1) for side in place], 4 * across
        around = tuple(slice(max(round(centre) - reach, 0), round(centre) + reach + 1) for centre in middle)
        window = repaired[around]
        axes = [
            torch.arange(part.start, part.start + side, device=image.device) - centre
            for part, side, centre in zip(around, window.shape, middle, strict=True)
        ]
        distance = torch.hypot(axes[0][:, None], axes[1][None, :])
        radius = math.sqrt(pixels / math.pi)
        while radius < reach and window[(distance >= radius) & (distance < radius + 2.0)].mean() > bright:
            radius += 1.0
        window[distance < radius + 1.0] = mean
    return repaired


def _replace_lines(image: torch.Tensor) -> tuple[torch.Tensor, int]:
    """Replace rows and columns whose mean differs from that of their neighbours much more than the means of other lines do."""
    replaced, step = 0, _smallest_step(_subsample(image))
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
