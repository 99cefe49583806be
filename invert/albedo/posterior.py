"""What samples of the posterior say together: mean, spread, where light is likely, alternatives, sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.ndimage import gaussian_filter
from scipy.spatial.distance import squareform

from correlograph.errors import InputError
from correlograph.lags import OBJECT_SIDE
from invert.albedo.registration import mutual_likeness, normalised, on_grid, padded, registered

DIFFERENT = 0.2
"""1 - correlation of samples, blurred by a lag, from which on they show different objects."""

BRIGHT = 0.5
"""Albedo from which on a pixel is bright; the largest of a sample is 1."""

SIZES = ("width", "height", "area")

Errors = Mapping[str, Sequence[float]]
"""Of each size, quantiles from 0 to 1, evenly spaced, of the truth's `Spread.error`."""


@dataclass(frozen=True)
class Alternative:
    """One of the answers: its probability, the samples that show it (their numbers), and the mean (64, 64) of these."""

    probability: float
    members: tuple[int, ...]
    albedo: np.ndarray


@dataclass(frozen=True)
class Spread:
    """Mean of a size over the samples, and the unit of its error: their deviation, and what a pixel at an edge may change."""

    mean: float
    scale: float

    @classmethod
    def of(cls, samples: np.ndarray, size: str) -> Spread:
        sizes = np.array([measured(one, size) for one in samples])
        return cls(float(sizes.mean()), float(sizes.std()) + 0.5 + 0.02 * float(sizes.mean()))

    def error(self, size: float) -> float:
        """How far a size lies from the samples' mean, over the scale."""
        return (size - self.mean) / self.scale


@dataclass(frozen=True)
class Posterior:
    """Equally likely objects, (n, 64, 64), float32, largest value 1 each, registered to the reconstruction.

    Attributes:
        errors: of their sizes, as calibration found them; without them, intervals are the samples' own quantiles.
    """

    samples: np.ndarray
    errors: Errors | None = None

    @property
    def mean(self) -> np.ndarray:
        """(64, 64)."""
        return self.samples.mean(0)

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation of every pixel, (64, 64)."""
        return self.samples.std(0)

    @property
    def bright(self) -> np.ndarray:
        """Probability that a pixel is bright, (64, 64)."""
        return (self.samples > BRIGHT).mean(0)

    def interval(self, size: str, probability: float) -> tuple[float, float]:
        """Credible interval of a size in lags, or in square lags: equal tails, 0 or more.

        Args:
            size: `width` or `height` of the bright part, or its `area`.
            probability: from 0 to 1.

        Raises:
            InputError: another size or probability.
        """
        if not 0.0 <= probability <= 1.0:
            raise InputError("probability", "0 to 1", probability, "give a share, such as 0.8")
        tails = 0.5 * (1.0 - probability), 0.5 * (1.0 + probability)
        quantiles = (self.errors or {}).get(size)
        if quantiles is None:
            low, high = np.quantile([measured(one, size) for one in self.samples], tails)
            return float(low), float(high)
        spread = Spread.of(self.samples, size)
        low, high = spread.mean + spread.scale * np.interp(tails, np.linspace(0.0, 1.0, len(quantiles)), quantiles)
        return max(float(low), 0.0), max(float(high), 0.0)

    def laid_over(self, albedo: np.ndarray) -> Posterior:
        """The same objects, brought to the place and the turn of an albedo (64, 64)."""
        return posterior(torch.from_numpy(self.samples), torch.from_numpy(albedo), self.errors)

    @cached_property
    def alternatives(self) -> list[Alternative]:
        """The different answers among the samples, likeliest first; one where all agree."""
        count = len(self.samples)
        if count == 1:
            return [Alternative(1.0, (0,), self.samples[0])]
        blurred = torch.stack([on_grid(gaussian_filter(one, 1.0)) for one in self.samples])
        likeness = mutual_likeness(blurred).numpy()
        apart = np.clip(1.0 - 0.5 * (likeness + likeness.T), 0.0, None)
        np.fill_diagonal(apart, 0.0)
        labels = fcluster(linkage(squareform(apart, checks=False), "average"), DIFFERENT, "distance")
        groups = [np.flatnonzero(labels == label) for label in np.unique(labels)]
        found = [Alternative(len(group) / count, tuple(group.tolist()), self.samples[group].mean(0)) for group in groups]
        return sorted(found, key=lambda one: -one.probability)


def measured(albedo: np.ndarray, size: str) -> float:
    """A size of the bright part of an albedo, in lags or square lags; 0 where nothing is bright.

    Raises:
        InputError: a size that is not in `SIZES`.
    """
    if size not in SIZES:
        raise InputError("size", f"one of {', '.join(SIZES)}", size, "choose one of these")
    lit = albedo > BRIGHT * albedo.max()
    if size == "area":
        return float(lit.sum())
    extent = np.flatnonzero(lit.any(0 if size == "width" else 1))
    return float(extent[-1] - extent[0] + 1) if extent.size else 0.0


def posterior(samples: torch.Tensor, albedo: torch.Tensor, errors: Errors | None = None) -> Posterior:
    """Samples (n, 64, 64), brought to the place and the turn of a reconstruction (64, 64)."""
    placed, _ = registered(padded(normalised(samples)), on_grid(albedo.numpy()))
    return Posterior(np.ascontiguousarray(placed[:, :OBJECT_SIDE, :OBJECT_SIDE].numpy(), np.float32), errors)
