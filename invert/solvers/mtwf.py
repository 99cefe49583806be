"""Median-truncated Wirtinger flow: truncated Wirtinger flow whose thresholds are medians, robust to outliers.

Zhang, Chi and Liang, ICML 2016 (PMLR 48, 1022), arXiv:1603.03805, algorithm 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.solvers.twf import Twf


@dataclass(frozen=True)
class Mtwf(Twf):
    """Retrieve real images of either sign; the typical error is the median."""

    spread: float = 12.0

    def typical(self, error: torch.Tensor) -> torch.Tensor:
        return error.flatten(-2).median(-1).values[..., None, None]
