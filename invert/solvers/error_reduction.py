"""Error reduction: alternate projections onto modulus, support and non-negativity.

Gerchberg, Optik 35, 237 (1972); Fienup, Applied Optics 21, 2758 (1982), doi:10.1364/AO.21.002758.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.solvers.base import Candidates, Progress, box_support, modulus_residual, no_progress, random_starts, to_modulus


@dataclass(frozen=True)
class ErrorReductionOptions:
    iterations: int = 2000
    starts: int = 16


def error_reduction(
    modulus: torch.Tensor,
    box: int,
    rng: torch.Generator,
    options: ErrorReductionOptions | None = None,
    progress: Progress = no_progress,
) -> Candidates:
    """Retrieve non-negative images; arguments as in `hio`. The residual never rises."""
    options = options or ErrorReductionOptions()
    target, support = modulus.unsqueeze(-3), box_support(modulus, box)
    image = random_starts(modulus, support, options.starts, rng)
    for _ in range(options.iterations):
        image = to_modulus(image, target).clamp_min_(0.0).mul_(support)
        progress()
    return Candidates(image, modulus_residual(image, target))
