"""Median-truncated Wirtinger flow: truncated Wirtinger flow whose thresholds are medians, robust to outliers.

Zhang, Chi and Liang, ICML 2016 (PMLR 48, 1022), arXiv:1603.03805, algorithm 1.
"""

from __future__ import annotations

import torch

from invert.solvers.base import Candidates, Progress, no_progress
from invert.solvers.twf import TwfOptions, truncated_flow

MTWF_OPTIONS = TwfOptions(spread=12.0)
"""Options as published."""


def mtwf(
    modulus: torch.Tensor, box: int, rng: torch.Generator, options: TwfOptions = MTWF_OPTIONS, progress: Progress = no_progress
) -> Candidates:
    """Retrieve real images of either sign; arguments as in `hio`. The typical error is the median."""

    def median(error: torch.Tensor) -> torch.Tensor:
        return error.flatten(-2).median(-1).values[..., None, None]

    return truncated_flow(modulus, box, rng, options, median, progress)
