"""Statistics of posterior samples: mean, standard deviation, clusters, sizes with credible intervals."""

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
from correlograph.ranges import CONFIDENCE
from invert.albedo.registration import normalise_peak, on_grid, pairwise_correlation, register_images, zero_pad

MIN_CLUSTER_DISTANCE = 0.2
"""Distance (1 - correlation, after a blur of one lag) above which samples belong to different clusters."""

BRIGHT_THRESHOLD = 0.5
"""Albedo above which a pixel counts as bright; the maximum of a sample is 1."""

SIZES = ("width", "height", "area")

SizeErrors = Mapping[str, Sequence[float]]
"""Quantiles of the error of each true size (see `SizeStatistics.error`), at equidistant probabilities from 0 to 1."""


@dataclass(frozen=True)
class SampleCluster:
    """Samples that show one object: their probability, their indices among all samples, and their mean albedo (64, 64)."""

    probability: float
    members: tuple[int, ...]
    albedo: np.ndarray


@dataclass(frozen=True)
class SizeStatistics:
    """Mean of a size over the samples, and the scale of its error: its standard deviation over the samples plus its change
    by one pixel at the edge.
    """

    mean: float
    scale: float

    @classmethod
    def of(cls, samples: np.ndarray, size: str) -> SizeStatistics:
        """Measure a size in samples (n, 64, 64)."""
        sizes = np.array([measure_size(one, size) for one in samples])
        return cls(float(sizes.mean()), float(sizes.std()) + 0.5 + 0.02 * float(sizes.mean()))

    def error(self, size: float) -> float:
        """Return the difference of a size from its mean over the samples, divided by the scale of its error."""
        return (size - self.mean) / self.scale


@dataclass(frozen=True)
class Samples:
    """Equally likely objects, (n, 64, 64), float32, maximum 1 each, registered to the reconstruction.

    Attributes:
        errors: calibrated errors of the sizes; without them, intervals are the quantiles of the samples.
    """

    samples: np.ndarray
    errors: SizeErrors | None = None

    def __post_init__(self) -> None:
        """Raise InputError for anything else than finite images of one shape."""
        samples = np.asarray(self.samples)
        if samples.dtype.kind not in "fiu" or samples.ndim != 3 or samples.size == 0 or not np.isfinite(samples).all():
            found = f"{samples.dtype} of shape {samples.shape}"
            raise InputError("samples", "finite images (n, height, width)", found, "check the array")
        object.__setattr__(self, "samples", samples)

    def __repr__(self) -> str:
        probabilities = ", ".join(f"{cluster.probability:.2f}" for cluster in self.clusters)
        return f"Samples({len(self.samples)} samples, probabilities of clusters {probabilities})"

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def mean(self) -> np.ndarray:
        """Mean albedo, (64, 64)."""
        return self.samples.mean(0)

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation of every pixel, (64, 64)."""
        return self.samples.std(0)

    @property
    def bright(self) -> np.ndarray:
        """Fraction of the samples in which a pixel is bright (above half of the maximum), (64, 64)."""
        return (self.samples > BRIGHT_THRESHOLD).mean(0)

    def interval(self, size: str, probability: float) -> tuple[float, float]:
        """Return the credible interval of a size in lags, or in square lags, with equal tails.

        Args:
            size: `width` or `height` of the bright part, or its `area`.
            probability: from 0 to 1.

        Raises:
            InputError: another size or probability.
        """
        probability = CONFIDENCE.check("probability", probability)
        if not isinstance(size, str) or size not in SIZES:
            raise InputError("size", f"one of {', '.join(SIZES)}", f"{size!r:.40}", "select one of these")
        tails = 0.5 * (1.0 - probability), 0.5 * (1.0 + probability)
        quantiles = (self.errors or {}).get(size)
        if quantiles is None:
            low, high = np.quantile([measure_size(one, size) for one in self.samples], tails)
            return float(low), float(high)
        statistics = SizeStatistics.of(self.samples, size)
        errors = np.interp(tails, np.linspace(0.0, 1.0, len(quantiles)), quantiles)
        low, high = statistics.mean + statistics.scale * errors
        return max(float(low), 0.0), max(float(high), 0.0)

    def register_to(self, albedo: np.ndarray) -> Samples:
        """Return the samples registered to an albedo (64, 64)."""
        return register_samples(torch.from_numpy(self.samples), torch.from_numpy(albedo), self.errors)

    @cached_property
    def clusters(self) -> list[SampleCluster]:
        """Clusters of samples that show different objects, most probable first."""
        count = len(self.samples)
        if count == 1:
            return [SampleCluster(1.0, (0,), self.samples[0])]
        blurred = torch.stack([on_grid(gaussian_filter(one, 1.0)) for one in self.samples])
        correlation = pairwise_correlation(blurred).numpy()
        distance = np.clip(1.0 - 0.5 * (correlation + correlation.T), 0.0, None)
        np.fill_diagonal(distance, 0.0)
        labels = fcluster(linkage(squareform(distance, checks=False), "average"), MIN_CLUSTER_DISTANCE, "distance")
        groups = [np.flatnonzero(labels == label) for label in np.unique(labels)]
        found = [SampleCluster(len(group) / count, tuple(group.tolist()), self.samples[group].mean(0)) for group in groups]
        return sorted(found, key=lambda cluster: -cluster.probability)


def measure_size(albedo: np.ndarray, size: str) -> float:
    """Measure the bright part of an albedo, in lags or square lags; 0 if no pixel is bright.

    Raises:
        InputError: a size that is not in `SIZES`.
    """
    if size not in SIZES:
        raise InputError("size", f"one of {', '.join(SIZES)}", size, "select one of these")
    is_bright = albedo > BRIGHT_THRESHOLD * albedo.max()
    if size == "area":
        return float(is_bright.sum())
    extent = np.flatnonzero(is_bright.any(0 if size == "width" else 1))
    return float(extent[-1] - extent[0] + 1) if extent.size else 0.0


def register_samples(samples: torch.Tensor, albedo: torch.Tensor, errors: SizeErrors | None = None) -> Samples:
    """Register samples (n, 64, 64) to a reconstruction (64, 64)."""
    registered, _ = register_images(zero_pad(normalise_peak(samples)), on_grid(albedo.numpy()))
    height, width = albedo.shape
    return Samples(np.ascontiguousarray(registered[:, :height, :width].numpy(), np.float32), errors)
