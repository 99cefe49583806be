"""Detection and replacement of pixels that are brighter than speckle can be: hot pixels, cosmic rays and specular highlights."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import find_objects, label

TAIL_DECADES = 5.0
"""Decades below a frequency of one pixel per frame to which the exponential tail is extrapolated; brighter pixels are hot."""

GLINT_PIXELS = 9
"""Minimum number of adjacent hot pixels that form a specular highlight, whose light fades into the speckle around it."""

MIN_PHOTONS, PHOTON_SPREAD = 20, 0.3
"""Minimum number of bright pixels that may be single photons, and maximum distance of the quartiles of their values relative to
their median above the dark level."""

MAX_SAMPLED_PIXELS, FEW_SAMPLED_PIXELS = 200_000, 20_000
"""Number of pixels from which the tail and the saturation are read, and from which a frame is seen to have no hot pixels."""

MIN_SINGLE = 10
"""Minimum number of pixels above the median from which the tail of the histogram is read if they are fewer than one in a thousand."""

SHARES, SHARES_OF_MEAN = (0.5, 0.99, 0.999), (0.5, 0.9, 0.99)
"""Fractions of the pixels below the values from which the tail is extrapolated, in a frame and in the mean of several: one pixel in a few
hundred may be warm in all frames."""

REACH = 2
"""Distance in pixels of the neighbours whose median replaces a hot pixel."""


@dataclass(frozen=True)
class _Tail:
    """Tail of the histogram of a frame: its median, a value that few pixels exceed, and the value beyond which pixels are hot, which is
    infinite for a frame without light."""

    middle: float
    bright: float
    limit: float

    @classmethod
    def of(cls, image: torch.Tensor, shares: tuple[float, float, float] = SHARES, samples: int = MAX_SAMPLED_PIXELS) -> _Tail:
        """Extrapolate the exponential tail of the histogram from the values below which some shares of the pixels are."""
        sampled = np.sort(subsample(image, samples))
        middle, bright, brightest = (float(sampled[int(share * len(sampled))]) for share in shares)
        if brightest == middle:
            photons = sampled[np.searchsorted(sampled, middle, "right") :]
            if len(photons) >= MIN_SINGLE:
                bright, brightest = (float(photons[int(share * len(photons))]) for share in (0.5, 0.9))
        # Counts of a few photons have few values, so the fraction that reaches one of them is not that of the quantile.
        decades = [-math.log10(1.0 - np.searchsorted(sampled, value) / len(sampled)) for value in (middle, bright, brightest)]
        rises = [
            (brightest - value) / (decades[2] - above)
            for value, above in zip((middle, bright), decades, strict=False)
            if brightest > value
        ]
        if not rises:
            return cls(middle, bright, math.inf)
        limit = brightest + max(rises) * (math.log10(image.numel()) - decades[2] + TAIL_DECADES)
        return cls(middle, bright, limit)


def replace_hot_pixels(image: torch.Tensor) -> tuple[torch.Tensor, int]:
    """Replace pixels of a frame (H, W) that are brighter than speckle can be by the median of their neighbours; return their number."""
    tail = _Tail.of(image)
    if float(image.max()) <= tail.limit:
        return image, 0
    hot = image > tail.limit
    if _are_single_photons(image[hot].cpu().numpy(), tail.middle):
        return image, 0
    repaired = _replace_highlights(image, hot, tail.bright)
    left = hot & (repaired > tail.limit)
    repaired[left] = _medians_around(repaired, left, hot, tail.middle)
    return repaired, int(hot.sum())


@dataclass(frozen=True, eq=False)
class HotPixels:
    """Pixels that are hot in the mean of several frames, bool (H, W). Many side by side, as in a small bright place, are not."""

    hot: torch.Tensor

    @classmethod
    def of(cls, images: Iterable[np.ndarray]) -> HotPixels:
        """Find the hot pixels of frames (H, W), at least one."""
        total, count = np.zeros(()), 0
        for image in images:
            total, count = total + image, count + 1
        mean = torch.from_numpy(np.asarray(total / count))
        hot = (mean > _Tail.of(mean, SHARES_OF_MEAN).limit).numpy()
        groups, _ = label(hot)
        return cls(torch.from_numpy(hot & (np.bincount(groups.ravel())[groups] < GLINT_PIXELS)))

    def replaced_in(self, image: np.ndarray) -> np.ndarray:
        """Return a frame (H, W), float32, without these pixels, and without others that are brighter than speckle can be in it."""
        frame = torch.from_numpy(image if image.flags.writeable else image.copy())
        if self.hot.any():
            frame = frame.clone()
            frame[self.hot] = _medians_around(frame, self.hot, self.hot, float(image.mean()))
        limit = _Tail.of(frame, samples=FEW_SAMPLED_PIXELS).limit
        if math.isinf(limit) or float(frame.max()) > limit:
            frame, _ = replace_hot_pixels(frame)
        return frame.numpy()


def subsample(image: torch.Tensor, count: int = MAX_SAMPLED_PIXELS) -> np.ndarray:
    """Return pixels at equal steps, about `count` of them."""
    return image.flatten()[:: max(1, image.numel() // count)].cpu().numpy()


def _medians_around(image: torch.Tensor, pixels: torch.Tensor, hot: torch.Tensor, otherwise: float) -> torch.Tensor:
    """Return the median of the neighbours of some pixels of a frame (H, W), leaving out those that are hot; another value where all are."""
    places = torch.nonzero(pixels)
    steps = torch.arange(-REACH, REACH + 1, device=image.device)
    rows, columns = (places[:, axis, None] + steps for axis in (0, 1))
    inside = [(one >= 0) & (one < side) for one, side in zip((rows, columns), image.shape, strict=True)]
    rows, columns = (one.clamp(0, side - 1) for one, side in zip((rows, columns), image.shape, strict=True))
    around = rows[:, :, None], columns[:, None, :]
    is_good = inside[0][:, :, None] & inside[1][:, None, :] & ~hot[around]
    medians = torch.where(is_good, image[around], torch.nan).flatten(1).nanmedian(1).values
    return torch.where(medians.isnan(), otherwise, medians)


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
