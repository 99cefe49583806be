"""Classical reconstructions as input of the fusion: a summary of all starts."""

from __future__ import annotations

import torch

from invert.albedo.registration import consensus, crop_centred, normalise_peak, register_images
from invert.solvers.base import Candidates


def summarise_retrievals(found: Candidates) -> tuple[torch.Tensor, list[float]]:
    """Return images (PICTURES, 64, 64) of all starts, and their mean correlations.

    For the retrieval from the estimate and that from its denoised signal (`found` holds both), these are the mean of the best starts,
    which is smooth where they differ, and the start with the lowest residual, which is sharp. All are registered to the first.
    """
    pictures, agreement = [], []
    for images, residual in zip(found.images, found.residual, strict=True):
        together = consensus(images, residual)
        pictures += [together.image, images[residual.argmin()]]
        agreement.append(together.agreement)
    laid_over, _ = register_images(torch.stack(pictures), pictures[0])
    return _crop_to_window(laid_over), agreement


def _crop_to_window(pictures: torch.Tensor) -> torch.Tensor:
    """Crop images (n, 128, 128) to their common middle, maximum 1 each; zero or more."""
    return normalise_peak(crop_centred(pictures.clamp_min(0.0)))
