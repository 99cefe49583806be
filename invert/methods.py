"""Reconstruction of an albedo from a measurement by one method."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from correlograph.lags import LAGS
from correlograph.workers import one_torch_thread
from invert.albedo.posterior import Samples, register_samples
from invert.albedo.registration import consensus, crop_centred, normalise_peak
from invert.choices import CLASSICAL, FAST, Method, Quality
from invert.likelihood.refinement import refine_by_likelihood
from invert.measure.spectrum import Measurement
from invert.network.checkpoints import DEFAULT_WEIGHTS, load_network
from invert.network.confidence import DEFAULT_COEFFICIENTS, ConfidenceFeatures, confidence
from invert.network.inference import network_progress_steps, reconstruct_by_network
from invert.solvers.base import Progress, no_progress
from invert.solvers.registry import solve, solver_options

BACKGROUND = 0.01
"""Albedo subtracted from the mean of many albedos, as a fraction of the maximum, because each contributes noise. Evidence:
docs/research.md."""

MIN_NETWORK_CONFIDENCE = 0.1
"""Minimum correlation with the truth that the network must predict; below it, no object is reported."""


@dataclass(frozen=True)
class Reconstruction:
    """Albedo (64, 64), float32, maximum 1, and its confidence. The albedo is zero if no object was found.

    Attributes:
        confidence: 0 to 1. For a network: predicted correlation with the truth. For other methods: mean correlation of the
            starts with the lowest residuals.
        residual: lowest relative squared error of the Fourier modulus over the starts; None for a network.
        transfer: phase retrieval transfer function: agreement of the starts, augmentations or samples per frequency; empty
            if there is only one image.
        posterior: samples of the posterior; None unless the method is `unet` and the quality is higher than `fast`.
        features: inputs of a network's confidence; None for other methods.
        rejected: image that the network reconstructed with too low a confidence; None if there is none.
    """

    albedo: np.ndarray
    object_found: bool
    confidence: float
    residual: float | None
    transfer: tuple[float, ...] = ()
    posterior: Samples | None = None
    features: ConfidenceFeatures | None = None
    rejected: np.ndarray | None = None

    def __repr__(self) -> str:
        found = "object found" if self.object_found else "no object found"
        return f"Reconstruction({found}, confidence {self.confidence:.2f})"


def empty_reconstruction(side: int) -> Reconstruction:
    """Return the reconstruction without an object, (side, side)."""
    return Reconstruction(np.zeros((side, side), np.float32), False, 0.0, None)


def progress_steps(method: Method, quality: Quality) -> int:
    """Return how many steps of progress a reconstruction reports."""
    return network_progress_steps(quality) if method.is_network else solver_options(method, quality).iterations


@one_torch_thread()
def reconstruct_measurement(
    measurement: Measurement,
    method: Method,
    quality: Quality,
    seed: int,
    device: str,
    progress: Progress = no_progress,
    weights: Path | None = None,
) -> Reconstruction:
    """Reconstruct a measurement on one thread; without a detectable signal the reconstruction is empty.

    Args:
        weights: file of weights for `unet` instead of those that ship.
    """
    if not measurement.detectable:
        return empty_reconstruction(measurement.lag_grid.object_side)
    if method.is_network:
        return _reconstruct_by_network(measurement, quality, seed, device, progress, weights or DEFAULT_WEIGHTS)
    found = solve(measurement, method, quality, seed, device, progress)
    together = consensus(found.images, found.residual)
    image = together.image if method == CLASSICAL else found.images[found.residual.argmin()]
    albedo = _crop_to_window(image, measurement.lag_grid.object_side)
    residual = float(found.residual.min())
    return Reconstruction(albedo.numpy(), bool(albedo.any()), together.agreement, residual, together.transfer)


def _reconstruct_by_network(
    measurement: Measurement, quality: Quality, seed: int, device: str, progress: Progress, weights: Path
) -> Reconstruction:
    network, metadata = load_network(weights, device)
    output = reconstruct_by_network(network, measurement, quality, seed, device, progress)
    calibration = metadata.get("calibration", {})
    predicted = float(confidence(calibration.get(quality.name, DEFAULT_COEFFICIENTS), output.features))
    predicted = min(predicted, output.most_confident)
    albedo = _postprocess_image(output.image, measurement, quality)
    samples = None
    if output.samples is not None and albedo.any():
        samples = register_samples(output.samples.cpu(), albedo, calibration.get("sizes"))
    found = Reconstruction(
        albedo.numpy(), bool(albedo.any()), predicted, None, output.transfer, posterior=samples, features=output.features
    )
    return found if predicted >= MIN_NETWORK_CONFIDENCE else _reject(found)


def _reject(found: Reconstruction) -> Reconstruction:
    """Report no object, and keep the image as `rejected`."""
    rejected = replace(empty_reconstruction(len(found.albedo)), confidence=found.confidence, features=found.features)
    return replace(rejected, rejected=found.albedo, posterior=None)


def _postprocess_image(image: torch.Tensor, measurement: Measurement, quality: Quality) -> torch.Tensor:
    """Crop the image (128, 128) of a network to an albedo (64, 64). Except for `fast`, refine it, unless there are more
    lags, on which the samples are already refined, and subtract its background.
    """
    albedo = _crop_to_window(image, measurement.lag_grid.object_side)
    if quality == FAST or not albedo.any():
        return albedo
    refined = refine_by_likelihood(albedo, measurement) if measurement.lag_grid.lags <= LAGS else albedo
    return normalise_peak((refined - BACKGROUND).clamp_min(0.0))


def _crop_to_window(image: torch.Tensor, side: int) -> torch.Tensor:
    """Centre the object in its window (side, side) and scale its maximum to 1."""
    return normalise_peak(crop_centred(image.clamp_min(0.0), side).cpu()).float()
