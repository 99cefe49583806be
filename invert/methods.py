"""All retrieval methods by name, and the qualities that trade their speed for accuracy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from invert.admm_tv import AdmmTvOptions, admm_tv
from invert.altmin import AltMinOptions, altmin
from invert.error_reduction import ErrorReductionOptions, error_reduction
from invert.hio import HioOptions, hio
from invert.mtwf import MTWF_OPTIONS, mtwf
from invert.projections import Progress
from invert.raar import RaarOptions, raar
from invert.registration import OBJECT, centred, consensus
from invert.spectrum import Measurement, fourier_modulus
from invert.taf import TafOptions, taf
from invert.twf import TwfOptions, twf

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


@dataclass(frozen=True)
class Reconstruction:
    """Albedo (64, 64), float32, largest value 1 (all zero when no object was found), and how far to trust it.

    `confidence` is the agreement of the best starts with one another, 0 to 1.
    """

    albedo: np.ndarray
    object_found: bool
    confidence: float
    residual: float | None


def method_options(method: str, quality: str) -> Any:
    """A method's options at a quality."""
    options = METHODS[method][1]
    starts, share = QUALITIES[quality]
    return replace(options, starts=starts, iterations=round(share * options.iterations))


def retrieve(measurement: Measurement, method: str, quality: str, seed: int, device: str,
             progress: Progress = lambda: None) -> Reconstruction:
    """Run a method by name; nothing is reconstructed from a measurement without a detectable object."""
    if measurement.detection < DETECTION_LIMIT or measurement.peak <= 0.0:
        return Reconstruction(np.zeros((OBJECT, OBJECT), np.float32), False, 0.0, None)
    modulus = fourier_modulus(measurement).to(device)
    # r*r that ends at a ring belongs to an object as wide as the ring's radius, plus one.
    box = min(OBJECT, measurement.noise.signal_ring + 3) if method == "classical" else OBJECT
    generator = torch.Generator(device=device).manual_seed(seed)
    found = METHODS[method][0](modulus, box, generator, method_options(method, quality), progress)
    image, agreement = consensus(found.images, found.residual)
    if method != "classical":
        image = found.images[found.residual.argmin()]
    albedo = centred(image.clamp_min(0.0)).cpu().numpy()
    top = float(albedo.max())
    return Reconstruction((albedo / top if top > 0.0 else albedo).astype(np.float32), top > 0.0, agreement,
                          float(found.residual.min()))
