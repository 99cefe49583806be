"""Registration under what no autocorrelation can tell: circular shift and a turn by 180 degrees."""

from __future__ import annotations

import torch

OBJECT = 64
"""Side of a reconstructed albedo, in lags."""


def turned(image: torch.Tensor) -> torch.Tensor:
    """Image turned by 180 degrees about pixel (0, 0) of the periodic grid."""
    return torch.roll(torch.flip(image, (-2, -1)), (1, 1), (-2, -1))


def registered(image: torch.Tensor, reference: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Shift and turn each image of a batch (n, H, W) to fit `reference` (H, W).

    Returns:
        the images, whole-pixel circular shifts, and their Pearson correlation with the reference, (n,).
    """
    height, width = reference.shape
    both = torch.stack((image, turned(image)), 1)
    both_zero_mean = both - both.mean((-2, -1), keepdim=True)
    reference_zero_mean = reference - reference.mean()
    spectrum = torch.fft.rfft2(reference_zero_mean) * torch.fft.rfft2(both_zero_mean).conj()
    correlation = torch.fft.irfft2(spectrum, s=(height, width)).flatten(1)
    norm = reference_zero_mean.norm() * both_zero_mean[:, 0].flatten(1).norm(dim=1)
    value, place = correlation.max(1)
    turn, shift = place // (height * width), place % (height * width)
    chosen = both[torch.arange(len(image), device=image.device), turn]
    moved = [torch.roll(one, (int(s) // width, int(s) % width), (0, 1)) for one, s in zip(chosen, shift, strict=True)]
    return torch.stack(moved), value / norm.clamp_min(1e-30)


def centred(image: torch.Tensor, side: int = OBJECT) -> torch.Tensor:
    """Cut the `side` x `side` window that holds the most of a periodic image (H, W), object in its middle."""
    for dimension in (0, 1):
        profile = image.sum(1 - dimension).double()
        length = profile.numel()
        window = torch.cat((profile, profile)).cumsum(0)
        held = window[side - 1 : side - 1 + length] - torch.cat((window.new_zeros(1), window))[:length]
        # Every window start that holds nearly all: a circular run, whose middle centres the object.
        full = held >= held.max() - 2e-3 * profile.sum().abs()
        angle = torch.arange(length, device=image.device) * (2.0 * torch.pi / length)
        middle = torch.atan2((full * angle.sin()).sum(), (full * angle.cos()).sum()) * length / (2.0 * torch.pi)
        image = torch.roll(image, -round(float(middle)), dimension)
    return image[:side, :side]


def consensus(images: torch.Tensor, residual: torch.Tensor, best: int = 6) -> tuple[torch.Tensor, float]:
    """Registered mean of the `best` candidates (starts, H, W), and their mean agreement (0 to 1).

    Candidates that fit the one of least residual badly (correlation below 0.7) are left out of the mean,
    but not of the agreement.
    """
    order = residual.argsort(stable=True)[:best]
    aligned, correlation = registered(images[order], images[order[0]])
    agreement = float(correlation[1:].mean().clamp(0.0, 1.0)) if len(order) > 1 else 1.0
    return aligned[correlation >= 0.7 * correlation.max()].mean(0), agreement
