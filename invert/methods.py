"""All retrieval methods by name, and the qualities that trade their speed for accuracy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from invert.hio import HioOptions, hio
from invert.registration import OBJECT, centred, consensus
from invert.spectrum import Measurement, fourier_modulus

DETECTION_LIMIT = 6.0
"""Standard deviations above the floor below which no object is claimed."""

QUALITIES = {
    "fast": HioOptions(iterations=600, starts=4),
    "balanced": HioOptions(),
    "best": HioOptions(starts=64),
}


@dataclass(frozen=True)
class Reconstruction:
    """Albedo (64, 64), float32, largest value 1 (all zero when no object was found), and how far to trust it.

    `confidence` is the agreement of the best starts with one another, 0 to 1.
    """

    albedo: np.ndarray
    object_found: bool
    confidence: float
    residual: float | None


Method = Callable[[Measurement, str, torch.Generator, Callable[[], object]], Reconstruction]


def retrieve_hio(measurement: Measurement, quality: str, generator: torch.Generator,
                 progress: Callable[[], object]) -> Reconstruction:
    """HIO with shrink-wrap from many starts; registered mean of those with the least residual."""
    modulus = fourier_modulus(measurement).to(generator.device)
    # r*r that ends at a ring belongs to an object as wide as the ring's radius, plus one.
    box = min(OBJECT, measurement.noise.signal_ring + 3)
    candidates = hio(modulus, box, generator, QUALITIES[quality], progress)
    image, agreement = consensus(candidates.images, candidates.residual)
    albedo = centred(image).clamp_min(0.0).cpu().numpy()
    top = float(albedo.max())
    return Reconstruction((albedo / top if top > 0.0 else albedo).astype(np.float32), top > 0.0, agreement,
                          float(candidates.residual.min()))


METHODS: dict[str, Method] = {"hio": retrieve_hio}


def retrieve(measurement: Measurement, method: str, quality: str, seed: int, device: str,
             progress: Callable[[], object] = lambda: None) -> Reconstruction:
    """Run a method by name; nothing is reconstructed from a measurement without a detectable object."""
    if measurement.detection < DETECTION_LIMIT or measurement.peak <= 0.0:
        return Reconstruction(np.zeros((OBJECT, OBJECT), np.float32), False, 0.0, None)
    generator = torch.Generator(device=device).manual_seed(seed)
    return METHODS[method](measurement, quality, generator, progress)
