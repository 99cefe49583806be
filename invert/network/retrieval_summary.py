"""What the network is shown of classical retrieval: all starts together."""

from __future__ import annotations

import torch

from invert.albedo.registration import consensus, crop_centred, normalise_peak, register_images
from invert.solvers.base import Candidates


def summarise_retrievals(found: Candidates) -> tuple[torch.Tensor, list[float]]:
    """Pictures (PICTURES, 64, 64) of all starts together, and how far they agree.

    Of the retrieval from the estimate and of that from its denoised signal (`found` holds both) the mean of the best starts,
    which is smooth where they differ, and the start of least residual, which is sharp; laid over the first.
    """
    pictures, agreement = [], []
    for images, residual in zip(found.images, found.residual, strict=True):
        together = consensus(images, residual)
        pictures += [together.image, images[residual.argmin()]]
        agreement.append(together.agreement)
    laid_over, _ = register_images(torch.stack(pictures), pictures[0])
    return _crop_to_window(laid_over), agreement


def _crop_to_window(pictures: torch.Tensor) -> torch.Tensor:
    """The middle of pictures (n, 128, 128), taken together, largest value 1 each; zero or more."""
    return normalise_peak(crop_centred(pictures.clamp_min(0.0)))
