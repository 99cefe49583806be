"""The classical solvers by name, and the qualities that trade their speed for accuracy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch

from correlograph.lags import OBJECT_SIDE
from invert.measure.spectrum import Measurement, fourier_modulus
from invert.solvers.admm_tv import AdmmTvOptions, admm_tv
from invert.solvers.altmin import AltMinOptions, altmin
from invert.solvers.base import Candidates, Progress
from invert.solvers.error_reduction import ErrorReductionOptions, error_reduction
from invert.solvers.hio import HioOptions, hio
from invert.solvers.mtwf import MTWF_OPTIONS, mtwf
from invert.solvers.raar import RaarOptions, raar
from invert.solvers.taf import TafOptions, taf
from invert.solvers.twf import TwfOptions, twf

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


def method_options(method: str, quality: str) -> Any:
    """A solver's options at a quality."""
    options = METHODS[method][1]
    starts, share = QUALITIES[quality]
    return replace(options, starts=starts, iterations=round(share * options.iterations))


def solve(measurement: Measurement, method: str, quality: str, seed: int, device: str,
          progress: Progress = lambda: None) -> Candidates:
    """Reconstructions (starts, 128, 128) of a measurement."""
    box = measurement.box if method == "classical" else OBJECT_SIDE
    rng = torch.Generator(device=device).manual_seed(seed)
    modulus = fourier_modulus(measurement).to(device)
    return METHODS[method][0](modulus, box, rng, method_options(method, quality), progress)
