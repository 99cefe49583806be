"""Alternating minimisation: phases from the image, image from the phases; the support is the only constraint.

Netrapalli, Jain and Sanghavi, NeurIPS 2013, arXiv:1306.0160, algorithm 1 without resampling, as in Metzler et al. 2020 (1000
iterations). For Fourier measurements of an image in a support, the least-squares step is a projection onto the support. The starts
are random, because the spectral start assumes Gaussian measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.solvers.base import Candidates, Progress, box_support, modulus_residual, no_progress, random_starts, to_modulus


@dataclass(frozen=True)
class AltMinOptions:
    iterations: int = 1000
    starts: int = 16


def altmin(
    modulus: torch.Tensor,
    box: int,
    rng: torch.Generator,
    options: AltMinOptions | None = None,
    progress: Progress = no_progress,
) -> Candidates:
    """Retrieve real images of either sign; arguments as in `hio`."""
    options = options or AltMinOptions()
    target, support = modulus.unsqueeze(-3), box_support(modulus, box)
    image = random_starts(modulus, support, options.starts, rng)
    for _ in range(options.iterations):
        image = to_modulus(image, target).mul_(support)
        progress()
    return Candidates(image, modulus_residual(image, target))
