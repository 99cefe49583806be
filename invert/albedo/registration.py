"""Registration up to the ambiguities of any autocorrelation: circular shift and twin image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from correlograph.lags import OBJECT_SIDE


def on_grid(image: np.ndarray, side: int = 2 * OBJECT_SIDE) -> torch.Tensor:
    """Zero-pad an image so that a circular shift of it is a plain one; float32 (side, side)."""
    grid = torch.zeros(side, side)
    grid[: image.shape[0], : image.shape[1]] = torch.as_tensor(np.ascontiguousarray(image, np.float32))
    return grid


def normalise_peak(albedos: torch.Tensor) -> torch.Tensor:
    """Albedos (..., H, W), largest value 1 each; zeros stay zeros."""
    return albedos / albedos.amax((-2, -1), keepdim=True).clamp_min(1e-30)


def zero_pad(albedos: torch.Tensor) -> torch.Tensor:
    """Albedos (..., 64, 64) on the grid of twice their side, where a circular shift is a plain one."""
    return torch.nn.functional.pad(albedos, (0, OBJECT_SIDE, 0, OBJECT_SIDE))


def rotate_180(image: torch.Tensor) -> torch.Tensor:
    """Image turned by 180 degrees about pixel (0, 0) of the periodic grid."""
    return torch.roll(torch.flip(image, (-2, -1)), (1, 1), (-2, -1))


def correlation_maps(image: torch.Tensor, reference: torch.Tensor) -> torch.Tensor:
    """Pearson correlation of each image (n, H, W) with `reference` (H, W) over all circular shifts.

    Returns:
        (n, 2, H, W): as it is, and turned.
    """
    both = torch.stack((image, rotate_180(image)), 1)
    both = both - both.mean((-2, -1), keepdim=True)
    reference = reference - reference.mean()
    spectrum = torch.fft.rfft2(reference) * torch.fft.rfft2(both).conj()
    norm = reference.norm() * torch.linalg.vector_norm(both, dim=(-2, -1), keepdim=True)
    return torch.fft.irfft2(spectrum, s=reference.shape) / norm.clamp_min(1e-30)


def register_images(image: torch.Tensor, reference: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Shift and turn each image of a batch (n, H, W) to fit `reference` (H, W).

    Returns:
        the images, whole-pixel circular shifts, and their Pearson correlation with the reference, (n,).
    """
    height, width = reference.shape
    value, place = correlation_maps(image, reference).flatten(1).max(1)
    moved = []
    for one, best in zip(image, place.tolist(), strict=True):
        turn, shift = divmod(best, height * width)
        moved.append(torch.roll(rotate_180(one) if turn else one, divmod(shift, width), (0, 1)))
    return torch.stack(moved), value


def pairwise_correlation(images: torch.Tensor) -> torch.Tensor:
    """Pearson correlation of images (n, H, W) with each other after the best shift and turn; (n, n), row by reference."""
    return torch.stack([register_images(images, one)[1] for one in images])


def register_groups(pictures: torch.Tensor, references: torch.Tensor) -> torch.Tensor:
    """Pictures of each object (n, k, 64, 64), shifted and turned together so that the first fits its reference (n, 64, 64).

    What would leave the window is lost, so a shift counts less by the fourth power of the mass it keeps.
    """
    side, grid = 2 * OBJECT_SIDE, (2 * OBJECT_SIDE, 2 * OBJECT_SIDE)
    ours, theirs = torch.fft.rfft2(pictures[:, 0], s=grid), torch.fft.rfft2(references, s=grid)
    window = torch.fft.rfft2(torch.ones_like(references), s=grid)
    # The twin image has the conjugate spectrum.
    both = torch.stack((ours.conj(), ours), 1)
    fit = torch.fft.irfft2(theirs[:, None] * both, s=grid)
    mass = pictures[:, 0].sum((-2, -1)).clamp_min(1e-12)[:, None, None, None]
    kept = torch.fft.irfft2(window[:, None] * both, s=grid).clamp_min(0.0) / mass
    moved = []
    for own, best in zip(pictures, (fit * kept**4).flatten(1).argmax(1).tolist(), strict=True):
        turn, shift = divmod(best, side * side)
        whole = zero_pad(own)
        moved.append(
            torch.roll(rotate_180(whole) if turn else whole, divmod(shift, side), (-2, -1))[:, :OBJECT_SIDE, :OBJECT_SIDE]
        )
    return torch.stack(moved)


def crop_centred(images: torch.Tensor, side: int = OBJECT_SIDE) -> torch.Tensor:
    """Cut the `side` x `side` window that holds the most of periodic images (..., H, W), taken together, in its middle."""
    for dimension in (-2, -1):
        profile = images.movedim(dimension, 0).flatten(1).sum(1).double()
        length = profile.numel()
        window = torch.cat((profile, profile)).cumsum(0)
        held = window[side - 1 : side - 1 + length] - torch.cat((window.new_zeros(1), window))[:length]
        # Every window start that holds nearly all: a circular run, whose middle centres the object.
        full = held >= held.max() - 2e-3 * profile.sum().abs()
        angle = torch.arange(length, device=images.device) * (2.0 * torch.pi / length)
        middle = torch.atan2((full * angle.sin()).sum(), (full * angle.cos()).sum()) * length / (2.0 * torch.pi)
        images = torch.roll(images, -round(float(middle)), dimension)
    return images[..., :side, :side]


@dataclass(frozen=True)
class Consensus:
    """Registered mean (H, W) of reconstructions, their mean agreement (0 to 1), and how it falls with spatial frequency.

    `transfer` is the phase retrieval transfer function (Chapman et al., J. Opt. Soc. Am. A 23, 1179, 2006,
    doi:10.1364/JOSAA.23.001179): |mean of F| over mean of |F|, averaged on rings of 0, 1, 2 ... cycles per `OBJECT_SIDE` lags. It
    is 1 where all have one phase, and 1 / sqrt(n) of them where each has its own.
    """

    image: torch.Tensor
    agreement: float
    transfer: tuple[float, ...]


def consensus(images: torch.Tensor, residual: torch.Tensor, best: int = 8, alike: float = 0.7) -> Consensus:
    """Combine the `best` starts (n, H, W) by residual.

    The one that agrees most with the others is the reference, not the one of least residual, which often
    fits the noise best. Candidates that agree badly with the reference (below `alike` of full correlation) are left
    out of the mean, but not of the agreement.
    """
    chosen = images[residual.argsort(stable=True)[:best]]
    mutual = pairwise_correlation(chosen)
    aligned, correlation = register_images(chosen, chosen[mutual.sum(1).argmax()])
    count = len(chosen)
    others = (mutual.sum() - mutual.diagonal().sum()) / (count * (count - 1)) if count > 1 else mutual.new_ones(())
    mean = mean_of_agreeing(aligned, correlation, alike)
    return Consensus(mean, float(others.clamp(0.0, 1.0)), phase_retrieval_transfer(aligned))


def mean_of_agreeing(aligned: torch.Tensor, correlation: torch.Tensor, alike: float = 0.7) -> torch.Tensor:
    """Mean (H, W) of registered images (n, H, W), without those whose correlation (n,) with the reference is below `alike` of
    the best one's."""
    return aligned[correlation >= alike * correlation.max()].mean(0)


def phase_retrieval_transfer(aligned: torch.Tensor) -> tuple[float, ...]:
    """Of registered images (n, H, W); see `Consensus`."""
    spectra = torch.fft.rfft2(aligned)
    ratio = spectra.mean(0).abs() / spectra.abs().mean(0).clamp_min(1e-30)
    row = torch.fft.fftfreq(aligned.shape[-2], device=aligned.device)[:, None]
    column = torch.fft.rfftfreq(aligned.shape[-1], device=aligned.device)
    ring = (torch.hypot(row, column) * OBJECT_SIDE).round().long().flatten()
    total = torch.zeros(OBJECT_SIDE, device=aligned.device).scatter_add_(0, ring, ratio.flatten())
    count = torch.zeros(OBJECT_SIDE, device=aligned.device).scatter_add_(0, ring, torch.ones_like(ratio).flatten())
    return tuple((total / count.clamp_min(1.0))[: OBJECT_SIDE // 2 + 1].tolist())
