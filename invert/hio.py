"""Hybrid input-output phase retrieval with shrink-wrap, many images and starts in one batch.

Fienup, Applied Optics 21, 2758 (1982), Eq. 44, doi:10.1364/AO.21.002758; shrink-wrap: Marchesini et
al., Physical Review B 68, 140101 (2003), doi:10.1103/PhysRevB.68.140101.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from invert.spectrum import GRID


@dataclass(frozen=True)
class HioOptions:
    """Published defaults (the paper's section 6.C) with shrink-wrap.

    Attributes:
        iterations: projections in all; the last `error_reduction` of them are plain error reduction.
        beta: feedback of the pixels that break the constraints.
        starts: random starting images.
        shrink_from, shrink_every: when the support is first, and how often it is then, redrawn.
        shrink_threshold: of the blurred image's maximum.
        shrink_blur: first and last standard deviation of the blur, in pixels; it falls by 5 % each time.
    """

    iterations: int = 2000
    beta: float = 0.9
    starts: int = 16
    error_reduction: int = 100
    shrink_from: int = 300
    shrink_every: int = 100
    shrink_threshold: float = 0.03
    shrink_blur: tuple[float, float] = (4.0, 2.0)


@dataclass(frozen=True)
class Candidates:
    """Reconstructions of each start: `images` (..., starts, 128, 128) and `residual` (..., starts).

    The residual is the relative squared error of the Fourier modulus; it never looks at a truth.
    """

    images: torch.Tensor
    residual: torch.Tensor


def to_modulus(image: torch.Tensor, modulus: torch.Tensor) -> torch.Tensor:
    """Project onto the measured Fourier modulus; a frequency that is exactly zero has no phase and stays zero."""
    spectrum = torch.fft.rfft2(image)
    # modulus / |spectrum|; several times faster than through a complex absolute value
    scale = spectrum.real.square().add_(spectrum.imag.square()).clamp_min_(1e-38).rsqrt_().mul_(modulus)
    return torch.fft.irfft2(spectrum.mul_(scale), s=(GRID, GRID))


def modulus_residual(image: torch.Tensor, modulus: torch.Tensor) -> torch.Tensor:
    """Relative squared modulus error of each image of a batch."""
    error = (torch.fft.rfft2(image).abs() - modulus).square().sum((-2, -1))
    return error / modulus.square().sum((-2, -1)).clamp_min(1e-30)


def blurred(image: torch.Tensor, deviation: float) -> torch.Tensor:
    """Periodic Gaussian blur, standard deviation in pixels."""
    row = torch.fft.fftfreq(GRID, device=image.device)[:, None]
    column = torch.fft.rfftfreq(GRID, device=image.device)
    transfer = torch.exp(-2.0 * (torch.pi * deviation) ** 2 * (row.square() + column.square()))
    return torch.fft.irfft2(torch.fft.rfft2(image) * transfer, s=(GRID, GRID))


def hio(modulus: torch.Tensor, box: int, generator: torch.Generator, options: HioOptions | None = None,
        progress: Callable[[], object] = lambda: None) -> Candidates:
    """Retrieve real, non-negative images from Fourier moduli.

    Args:
        modulus: (..., 128, 65), leading dimensions are images.
        box: side of the square that holds the object, at most 64 pixels.
        generator: source of the starting images; on the same device as `modulus`.
        progress: called once per iteration.
    """
    options = options or HioOptions()
    target = modulus.unsqueeze(-3)
    shape = (*modulus.shape[:-2], options.starts, GRID, GRID)
    support = torch.zeros(GRID, GRID, device=modulus.device)
    support[:box, :box] = 1.0
    image = torch.rand(shape, generator=generator, device=modulus.device) * support
    blur, last_blur = options.shrink_blur
    hybrid = options.iterations - options.error_reduction
    for iteration in range(options.iterations):
        projected = to_modulus(image, target)
        allowed = (projected * support).clamp_min_(0.0).sign_()  # 1 where the constraints hold, else 0
        if iteration >= hybrid:
            image = projected.mul_(allowed)
        else:
            # projected where allowed, image - beta projected elsewhere
            image = image.sub_(projected, alpha=options.beta).lerp_(projected, allowed)
            if iteration >= options.shrink_from and iteration % options.shrink_every == 0:
                smooth = blurred(projected * allowed, blur)
                support = (smooth > options.shrink_threshold * smooth.amax((-2, -1), keepdim=True)).float()
                blur = max(last_blur, 0.95 * blur)
        progress()
    return Candidates(image, modulus_residual(image, target))
