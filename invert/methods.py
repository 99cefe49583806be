"""All retrieval methods by name, and the qualities that trade their speed for accuracy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from invert.admm_tv import AdmmTvOptions, admm_tv
from invert.altmin import AltMinOptions, altmin
from invert.calibrate import confidence
from invert.error_reduction import ErrorReductionOptions, error_reduction
from invert.features import PICTURES, Observation
from invert.hio import HioOptions, hio
from invert.learned import denoise, looks, observation
from invert.mtwf import MTWF_OPTIONS, mtwf
from invert.projections import Candidates, Progress
from invert.raar import RaarOptions, raar
from invert.registration import OBJECT, centred, consensus, registered
from invert.spectrum import Measurement, denoised_modulus, fourier_modulus
from invert.taf import TafOptions, taf
from invert.twf import TwfOptions, twf
from invert.unet import CorrelographyNet
from invert.weights import SHIPPED, load_network

DETECTION_LIMIT = 6.0
"""Standard deviations above the floor below which no object is claimed."""

METHODS: dict[str, tuple[Any, Any]] = {
    "classical": (hio, HioOptions()),
    "hio": (hio, HioOptions(shrink_every=0)),
    "raar": (raar, RaarOptions()),
    "er": (error_reduction, ErrorReductionOptions()),
    "altmin": (altmin, AltMinOptions()),
    "twf": (twf, TwfOptions()),
    "taf": (taf, TafOptions()),
    "mtwf": (mtwf, MTWF_OPTIONS),
    "admm-tv": (admm_tv, AdmmTvOptions()),
}
"""Solver and options. All but `classical` run as published: 64 x 64 support, the start of least residual. `classical` is HIO
with shrink-wrap in the box that the measured signal allows, and the registered mean of the best starts."""

QUALITIES = {"fast": (4, 0.3), "balanced": (16, 1.0), "best": (64, 1.0)}
"""Starts, and share of a method's iterations."""


NETWORK_LOOKS = {"fast": (1, "fast"), "balanced": (4, "balanced"), "best": (4, "best")}
"""Poses in which the network looks, and the quality of the classical reconstruction that it is shown."""

UNCALIBRATED = (0.0, 1.0, 0.0, 0.0, 0.0)
"""Confidence of a network without calibration: what it expects of itself."""

BELIEVED = 0.1
"""Correlation with the truth that a network must expect of its picture to claim an object."""


@dataclass(frozen=True)
class Reconstruction:
    """Albedo (64, 64), float32, largest value 1 (all zero when no object was found), and how far to trust it.

    Attributes:
        confidence: of a network, the correlation with the truth that it expects; of any other method, the agreement of the
            best starts with one another; 0 to 1.
        residual: relative squared error of the Fourier modulus, least over the starts; None for a network.
        transfer: phase retrieval transfer function of the starts or poses, empty where there was one.
    """

    albedo: np.ndarray
    object_found: bool
    confidence: float
    residual: float | None
    transfer: tuple[float, ...] = ()


NOTHING = Reconstruction(np.zeros((OBJECT, OBJECT), np.float32), False, 0.0, None)


def detectable(measurement: Measurement) -> bool:
    """Whether a measurement shows enough for a retrieval to begin."""
    return measurement.detection >= DETECTION_LIMIT and measurement.peak > 0.0


def method_options(method: str, quality: str) -> Any:
    """A solver's options at a quality."""
    options = METHODS[method][1]
    starts, share = QUALITIES[quality]
    return replace(options, starts=starts, iterations=round(share * options.iterations))


def iterations(method: str, quality: str) -> int:
    """How often a retrieval will report progress."""
    if method == "unet":
        return method_options("classical", NETWORK_LOOKS[quality][1]).iterations
    return method_options(method, quality).iterations


def retrieve(measurement: Measurement, method: str, quality: str, seed: int, device: str,
             progress: Progress = lambda: None, weights: Path | None = None) -> Reconstruction:
    """Run a method by name; nothing is reconstructed from a measurement without a detectable object.

    Args:
        weights: another network than the shipped one, for `unet`.
    """
    if not detectable(measurement):
        return NOTHING
    if method == "unet":
        return _by_network(measurement, quality, seed, device, progress, weights or SHIPPED)
    found = _solve(measurement, fourier_modulus(measurement), method, quality, seed, device, progress)
    together = consensus(found.images, found.residual)
    image = together.image if method == "classical" else found.images[found.residual.argmin()]
    return _normalised(image, together.agreement, float(found.residual.min()), together.transfer)


def _solve(measurement: Measurement, modulus: torch.Tensor, method: str, quality: str, seed: int, device: str,
           progress: Progress) -> Candidates:
    """Reconstructions from one modulus (128, 65) or several (n, 128, 65) of a measurement."""
    # r*r that ends at a ring belongs to an object as wide as the ring's radius, plus one.
    box = min(OBJECT, measurement.noise.signal_ring + 3) if method == "classical" else OBJECT
    generator = torch.Generator(device=device).manual_seed(seed)
    return METHODS[method][0](modulus.to(device), box, generator, method_options(method, quality), progress)


def classical_pictures(measurement: Measurement, denoised: torch.Tensor, quality: str, seed: int, device: str,
                       progress: Progress = lambda: None) -> tuple[torch.Tensor, list[float]]:
    """What a network is shown of the classical retrieval: pictures (PICTURES, 64, 64), and how far its starts agree.

    From the estimate and from its denoised signal (127, 127), whose noise is less but whose fine structure is, too: of each
    the mean of the best starts, which is smooth where they differ, and the start of least residual, which is sharp. Laid over
    the first, largest value 1 each; zeros where no object can be detected.
    """
    if not detectable(measurement):
        return torch.zeros(PICTURES, OBJECT, OBJECT), [0.0, 0.0]
    pictures, agreement = [], []
    moduli = torch.stack((fourier_modulus(measurement), denoised_modulus(denoised.cpu().numpy(), measurement)))
    found = _solve(measurement, moduli, "classical", quality, seed, device, progress)
    for images, residual in zip(found.images, found.residual, strict=True):
        together = consensus(images, residual)
        pictures += [together.image, images[residual.argmin()]]
        agreement.append(together.agreement)
    laid_over, _ = registered(torch.stack(pictures), pictures[0])
    window = centred(laid_over.clamp_min(0.0))
    return window / window.amax((-2, -1), keepdim=True).clamp_min(1e-30), agreement


def _by_network(measurement: Measurement, quality: str, seed: int, device: str, progress: Progress,
                weights: Path) -> Reconstruction:
    """The network's picture, if it believes it."""
    image, signs, transfer = draw(measurement, quality, seed, device, weights, progress)
    fit = load_network(weights, device)[1].get("calibration", {}).get(quality, UNCALIBRATED)
    trust = float(confidence(fit, np.array(signs)))
    if trust < BELIEVED:
        return replace(NOTHING, confidence=trust)
    return _normalised(image, trust, None, transfer)


def shown(network: nn.Module, measurement: Measurement, quality: str, seed: int, device: str,
          progress: Progress = lambda: None) -> tuple[Observation, list[float]]:
    """What a network is shown of a measurement, and how far the classical starts with and without noise agree."""
    seen = observation([measurement]).part(slice(None), device)
    if not isinstance(network, CorrelographyNet):
        return seen, [0.0, 0.0]
    poses, classical_quality = NETWORK_LOOKS[quality]
    denoised = denoise(network, seen, poses)
    pictures, agreement = classical_pictures(measurement, denoised[0], classical_quality, seed, device, progress)
    return replace(seen, denoised=denoised, classical=pictures[None].to(device)), agreement


def draw(measurement: Measurement, quality: str, seed: int, device: str, weights: Path,
         progress: Progress = lambda: None) -> tuple[torch.Tensor, tuple[float, ...], tuple[float, ...]]:
    """Denoise the estimate, retrieve from that, and let the network look at what was retrieved, in one pose or several.

    Returns:
        the picture (128, 128), periodic; signs of how good it is (the logit of the correlation that the network
        expects, agreement of its poses, of the classical starts with and without noise); the poses' transfer function.
    """
    network, _ = load_network(weights, device)
    poses, _ = NETWORK_LOOKS[quality]
    seen, agreement = shown(network, measurement, quality, seed, device, progress)
    images, logit = looks(network, seen, poses)
    together = consensus(torch.nn.functional.pad(images, (0, OBJECT, 0, OBJECT)), torch.zeros(poses))
    return together.image, (logit, together.agreement, *agreement), together.transfer if poses > 1 else ()


def _normalised(image: torch.Tensor, confidence: float, residual: float | None,
                transfer: tuple[float, ...]) -> Reconstruction:
    """The object in the middle of its window, largest value 1."""
    albedo = centred(image.clamp_min(0.0)).cpu().numpy()
    top = float(albedo.max())
    return Reconstruction((albedo / top if top > 0.0 else albedo).astype(np.float32), top > 0.0, confidence, residual,
                          transfer)
