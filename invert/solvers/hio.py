"""Hybrid input-output phase retrieval with shrink-wrap, many images and starts in one batch.

Fienup, Applied Optics 21, 2758 (1982), Eq. 44, doi:10.1364/AO.21.002758; shrink-wrap: Marchesini et
al., Physical Review B 68, 140101 (2003), doi:10.1103/PhysRevB.68.140101.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from invert.solvers.base import (
    Candidates,
    Progress,
    box_support,
    gaussian_blur,
    modulus_residual,
    no_progress,
    random_starts,
    to_modulus,
)


@dataclass(frozen=True)
class HioOptions:
    """Published options (Metzler et al. 2020, section 6.C) with shrink-wrap.

    Attributes:
        iterations: total number of projections; the last `error_reduction` of them are plain error reduction.
        beta: feedback of the pixels that violate the constraints.
        starts: random starting images.
        shrink_from, shrink_every: first iteration and interval of support updates; 0 for none.
        shrink_threshold: fractions of the blurred image's maximum, cycled over the starts.
        shrink_blur: first and last standard deviation of the blur, in pixels; it falls by 5 % each time.
    """

    iterations: int = 2000
    beta: float = 0.9
    starts: int = 16
    error_reduction: int = 100
    shrink_from: int = 300
    shrink_every: int = 100
    shrink_threshold: tuple[float, ...] = (0.03,)
    shrink_blur: tuple[float, float] = (4.0, 2.0)


def hio(
    modulus: torch.Tensor, box: int, rng: torch.Generator, options: HioOptions | None = None, progress: Progress = no_progress
) -> Candidates:
    """Retrieve real, non-negative images from Fourier moduli.

    Args:
        modulus: (..., n, n // 2 + 1), leading dimensions are images.
        box: side of the square that holds the object, at most n / 2 pixels.
        rng: source of the starting images; on the same device as `modulus`.
        progress: called once per iteration.
    """
    options = options or HioOptions()
    target = modulus.unsqueeze(-3)
    support = box_support(modulus, box)
    image = random_starts(modulus, support, options.starts, rng)
    blur, last_blur = options.shrink_blur
    thresholds = torch.tensor(options.shrink_threshold, device=modulus.device).repeat(options.starts)
    threshold = thresholds[: options.starts, None, None]
    hybrid = options.iterations - options.error_reduction
    for iteration in range(options.iterations):
        projected = to_modulus(image, target)
        allowed = (projected * support).clamp_min_(0.0).sign_()  # 1 where the constraints hold, else 0
        if iteration >= hybrid:
            image = projected.mul_(allowed)
        else:
            # projected where allowed, image - beta projected elsewhere
            image = image.sub_(projected, alpha=options.beta).lerp_(projected, allowed)
            if options.shrink_every and iteration >= options.shrink_from and iteration % options.shrink_every == 0:
                smooth = gaussian_blur(projected * allowed, blur)
                support = (smooth > threshold * smooth.amax((-2, -1), keepdim=True)).float()
                blur = max(last_blur, 0.95 * blur)
        progress()
    return Candidates(image, modulus_residual(image, target))
