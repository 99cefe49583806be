"""Reconstruction of an albedo from a measurement by one method: a network or a solver."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from correlograph.lags import LAGS
from correlograph.progress import Progress, no_progress
from correlograph.workers import one_torch_thread
from invert.albedo.posterior import Samples, register_samples
from invert.albedo.registration import consensus, crop_centred, normalise_peak
from invert.choices import CLASSICAL, FAST, Method, Quality
from invert.likelihood.refinement import refine_by_likelihood
from invert.measure.spectrum import Measurement, fourier_modulus
from invert.network.checkpoints import load_network
from invert.network.confidence import DEFAULT_COEFFICIENTS, ConfidenceFeatures, confidence
from invert.network.inference import network_progress_steps, reconstruct_by_network
from invert.solvers.base import PhaseProblem, Solver, solve
from invert.solvers.registry import SOLVERS

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


class Reconstructor(Protocol):
    """A method at one quality.

    Attributes:
        steps: number of steps of progress that it reports.
    """

    @property
    def steps(self) -> int: ...

    def run(self, measurement: Measurement, seed: int = 0, progress: Progress = no_progress) -> Reconstruction:
        """Reconstruct a measurement on one thread; without a detectable signal the reconstruction is empty."""
        ...


def reconstructor(method: Method, quality: Quality, device: str = "cpu", weights: Path | None = None) -> Reconstructor:
    """Return what runs a method.

    Args:
        weights: file of weights of the network instead of those that ship.
    """
    if method.weights is not None:
        return NetworkReconstructor(quality, device, weights or method.weights)
    solver = SOLVERS[method.name]
    options = {"starts": quality.solver_starts, "iterations": round(quality.solver_iterations * solver.iterations)}
    return SolverReconstructor(replace(solver, **options), device, averages=method == CLASSICAL)


@dataclass(frozen=True)
class SolverReconstructor:
    """A classical method.

    Attributes:
        averages: whether the support is derived from the signal extent and the result is the mean of the starts with the lowest
            residuals; otherwise the support is the window, and the result is the start of the lowest residual.
    """

    solver: Solver[Any]
    device: str
    averages: bool

    @property
    def steps(self) -> int:
        return self.solver.iterations

    @one_torch_thread()
    def run(self, measurement: Measurement, seed: int = 0, progress: Progress = no_progress) -> Reconstruction:
        side = measurement.lag_grid.object_side
        if not measurement.detectable:
            return empty_reconstruction(side)
        problem = PhaseProblem(fourier_modulus(measurement).to(self.device), measurement.box if self.averages else side)
        found = solve(self.solver, problem, torch.Generator(device=self.device).manual_seed(seed), progress)
        together = consensus(found.images, found.residual)
        image = together.image if self.averages else found.images[found.residual.argmin()]
        albedo = _crop_to_window(image, side)
        residual = float(found.residual.min())
        return Reconstruction(albedo.numpy(), bool(albedo.any()), together.agreement, residual, together.transfer)


@dataclass(frozen=True)
class NetworkReconstructor:
    """A trained network, and the calibration of its confidence."""

    quality: Quality
    device: str
    weights: Path

    @property
    def steps(self) -> int:
        return network_progress_steps(self.quality)

    @one_torch_thread()
    def run(self, measurement: Measurement, seed: int = 0, progress: Progress = no_progress) -> Reconstruction:
        if not measurement.detectable:
            return empty_reconstruction(measurement.lag_grid.object_side)
        network, metadata = load_network(self.weights, self.device)
        output = reconstruct_by_network(network, measurement, self.quality, seed, self.device, progress)
        calibration = metadata.get("calibration", {})
        predicted = float(confidence(calibration.get(self.quality.name, DEFAULT_COEFFICIENTS), output.features))
        predicted = min(predicted, output.most_confident)
        albedo = _postprocess_image(output.image, measurement, self.quality)
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
