"""Median-truncated Wirtinger flow: truncated Wirtinger flow whose thresholds are medians, robust to outliers.

Zhang, Chi and Liang, ICML 2016 (PMLR 48, 1022), arXiv:1603.03805, algorithm 1 with its published constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.projections import Candidates, Progress, box_support, modulus_residual
from invert.twf import full_intensity, poisson_gradient, start_at_scale, within


@dataclass(frozen=True)
class MtwfOptions:
    """`spread` multiplies the median of the intensity error; the rest as in `TwfOptions`."""

    iterations: int = 1000
    starts: int = 16
    step: float = 0.2
    lower: float = 0.3
    upper: float = 5.0
    spread: float = 12.0


def mtwf(modulus: torch.Tensor, box: int, generator: torch.Generator, options: MtwfOptions | None = None,
         progress: Progress = lambda: None) -> Candidates:
    """Retrieve real images of either sign; arguments as in `hio`."""
    options = options or MtwfOptions()
    support, intensity = box_support(modulus, box), full_intensity(modulus)
    image = start_at_scale(modulus, support, options.starts, generator)
    for _ in range(options.iterations):
        spectrum = torch.fft.fft2(image)
        magnitude = spectrum.abs()
        norm = image.square().sum((-2, -1), keepdim=True).sqrt().clamp_min(1e-30)
        error = (intensity - magnitude.square()).abs()
        median = error.flatten(-2).median(-1).values[..., None, None]
        kept = within(magnitude, norm, options.lower, options.upper) & (error <= options.spread * median * magnitude / norm)
        image = image - options.step * poisson_gradient(spectrum, intensity, kept) * support
        progress()
    return Candidates(image, modulus_residual(image, modulus.unsqueeze(-3)))
