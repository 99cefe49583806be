"""From a measurement to an albedo by any method, or to none where no object is detected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from correlograph.lags import OBJECT_SIDE
from invert.albedo.posterior import Posterior, posterior
from invert.albedo.registration import centred, consensus, normalised
from invert.likelihood.refinement import refined
from invert.measure.spectrum import Measurement
from invert.network.checkpoints import SHIPPED, load_network
from invert.network.confidence import UNCALIBRATED, confidence
from invert.network.inference import RETRIEVAL, reconstruct_by_network
from invert.solvers.base import Progress
from invert.solvers.registry import method_options, solve

BACKGROUND = 0.01
"""Of the largest albedo, subtracted from the mean of many albedos, each with noise of its own: it costs .002 in correlation and
gains .03 in SSIM on one-pixel edges (b 80, K 64)."""

BELIEVED = 0.1
"""Correlation with the truth that a network must expect of its reconstruction to claim an object."""


@dataclass(frozen=True)
class Reconstruction:
    """Albedo (64, 64), float32, largest value 1 (all zero when no object was found), and how far to trust it.

    Attributes:
        confidence: of a network, the correlation with the truth that it expects; of any other method, the agreement of the
            best starts with one another; 0 to 1.
        residual: relative squared error of the Fourier modulus, least over the starts; None for a network.
        transfer: phase retrieval transfer function of the starts, augmentations or samples, empty where there was one.
        posterior: samples of what else the object may be; None for all but the default network above `fast`.
    """

    albedo: np.ndarray
    object_found: bool
    confidence: float
    residual: float | None
    transfer: tuple[float, ...] = ()
    posterior: Posterior | None = None


NOTHING = Reconstruction(np.zeros((OBJECT_SIDE, OBJECT_SIDE), np.float32), False, 0.0, None)


def iterations(method: str, quality: str) -> int:
    """How often a retrieval will report progress."""
    return (RETRIEVAL if method == "unet" else method_options(method, quality)).iterations


def retrieve(measurement: Measurement, method: str, quality: str, seed: int, device: str,
             progress: Progress = lambda: None, weights: Path | None = None) -> Reconstruction:
    """Run a method by name; nothing is reconstructed from a measurement without a detectable object.

    Args:
        weights: another network than the shipped one, for `unet`.
    """
    if not measurement.detectable:
        return NOTHING
    if method == "unet":
        return _by_network(measurement, quality, seed, device, progress, weights or SHIPPED)
    found = solve(measurement, method, quality, seed, device, progress)
    together = consensus(found.images, found.residual)
    image = together.image if method == "classical" else found.images[found.residual.argmin()]
    return _reconstruction(_normalised(image), together.agreement, float(found.residual.min()), together.transfer)


def _by_network(measurement: Measurement, quality: str, seed: int, device: str, progress: Progress,
                weights: Path) -> Reconstruction:
    """The network's reconstruction, if it is trusted."""
    network, card = load_network(weights, device)
    answer = reconstruct_by_network(network, measurement, quality, seed, device, progress)
    calibration = card.get("calibration", {})
    trust = float(confidence(calibration.get(quality, UNCALIBRATED), answer.features))
    if trust < BELIEVED:
        return replace(NOTHING, confidence=trust)
    albedo = finished(answer.image, measurement, quality)
    has_samples = answer.samples is not None and albedo.any()
    drawn = posterior(answer.samples.cpu(), albedo, calibration.get("sizes")) if has_samples else None
    return replace(_reconstruction(albedo, trust, None, answer.transfer), posterior=drawn)


def finished(image: torch.Tensor, measurement: Measurement, quality: str) -> torch.Tensor:
    """The albedo (64, 64) that a network's image (128, 128) becomes; but for `fast` after likelihood ascent, less its
    background."""
    albedo = _normalised(image)
    if quality == "fast" or not albedo.any():
        return albedo
    return normalised((refined(albedo, measurement) - BACKGROUND).clamp_min(0.0))


def _normalised(image: torch.Tensor) -> torch.Tensor:
    """The object in the middle of its window (64, 64), largest value 1."""
    return normalised(centred(image.clamp_min(0.0)).cpu()).float()


def _reconstruction(albedo: torch.Tensor, confidence: float, residual: float | None,
                    transfer: tuple[float, ...]) -> Reconstruction:
    return Reconstruction(albedo.numpy(), bool(albedo.any()), confidence, residual, transfer)
