"""The classical methods by name, with their published options."""

from __future__ import annotations

from typing import Any

from invert.solvers.admm_tv import AdmmTv
from invert.solvers.altmin import AltMin
from invert.solvers.base import Solver
from invert.solvers.error_reduction import ErrorReduction
from invert.solvers.hio import Hio
from invert.solvers.mtwf import Mtwf
from invert.solvers.raar import Raar
from invert.solvers.taf import Taf
from invert.solvers.twf import Twf

SOLVERS: dict[str, Solver[Any]] = {
    "classical": Hio(),
    "hio": Hio(shrink_every=0),
    "raar": Raar(),
    "er": ErrorReduction(),
    "altmin": AltMin(),
    "twf": Twf(),
    "taf": Taf(),
    "mtwf": Mtwf(),
    "admm-tv": AdmmTv(),
}
"""All except `classical` run as published: in a support of 64 x 64, with the start of the lowest residual as the result. `classical`
is HIO with shrink-wrap in a square support derived from the signal extent; its result is the registered mean of the starts with the
lowest residuals."""
