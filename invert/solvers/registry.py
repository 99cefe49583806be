"""Solvers and options of the classical methods."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch

from invert.choices import CLASSICAL, Method, Quality
from invert.measure.spectrum import Measurement, fourier_modulus
from invert.solvers.admm_tv import AdmmTvOptions, admm_tv
from invert.solvers.altmin import AltMinOptions, altmin
from invert.solvers.base import Candidates, Progress, no_progress
from invert.solvers.error_reduction import ErrorReductionOptions, error_reduction
from invert.solvers.hio import HioOptions, hio
from invert.solvers.mtwf import MTWF_OPTIONS, mtwf
from invert.solvers.raar import RaarOptions, raar
from invert.solvers.taf import TafOptions, taf
from invert.solvers.twf import TwfOptions, twf

_SOLVERS: dict[str, tuple[Any, Any]] = {
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
"""Solver and published options of each classical method. All except `classical` run as published: in a support of 64 x 64, with
the start of the lowest residual as the result. `classical` is HIO with shrink-wrap in a square support derived from the signal
extent; its result is the registered mean of the starts with the lowest residuals."""


def solver_of(method: Method) -> Any:
    """Return the function of a classical method."""
    return _SOLVERS[method.name][0]


def solver_options(method: Method, quality: Quality) -> Any:
    """Return the options of a classical method at a quality."""
    options = _SOLVERS[method.name][1]
    iterations = round(quality.solver_iterations * options.iterations)
    return replace(options, starts=quality.solver_starts, iterations=iterations)


def solve(
    measurement: Measurement,
    method: Method,
    quality: Quality,
    seed: int,
    device: str,
    progress: Progress = no_progress,
) -> Candidates:
    """Retrieve the phase of a measurement from random starts; images (starts, 128, 128)."""
    support_side = measurement.box if method == CLASSICAL else measurement.lag_grid.object_side
    rng = torch.Generator(device=device).manual_seed(seed)
    modulus = fourier_modulus(measurement).to(device)
    return solver_of(method)(modulus, support_side, rng, solver_options(method, quality), progress)
