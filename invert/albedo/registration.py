"""Registration up to the ambiguities of any autocorrelation: circular shift and twin image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch


def on_grid(image: np.ndarray, side: int | None = None) -> torch.Tensor:
    """Zero-pad an image to twice its longer side, or to `side`, so that a circular shift loses nothing; float32 (side, side)."""
    side = 2 * max(image.shape) if side is None else side
    grid = torch.zeros(side, side)
    grid[: image.shape[0], : image.shape[1]] = torch.as_tensor(np.ascontiguousarray(image, np.float32))
    return grid


def normalise_peak(albedos: torch.Tensor) -> torch.Tensor:
    """Scale albedos (..., H, W) to a maximum of 1 each; zeros stay zeros."""
    return albedos / albedos.amax((-2, -1), keepdim=True).clamp_min(1e-30)


def zero_pad(albedos: torch.Tensor) -> torch.Tensor:
    """Zero-pad albedos (..., 64, 64) to twice their side, so that a circular shift loses nothing."""
    return torch.nn.functional.pad(albedos, (0, albedos.shape[-1], 0, albedos.shape[-2]))


def rotate_180(image: torch.Tensor) -> torch.Tensor:
    """Rotate an image by 180 degrees about pixel (0, 0) of the periodic grid."""
    return torch.roll(torch.flip(image, (-2, -1)), (1, 1), (-2, -1))


def correlation_maps(image: torch.Tensor, reference: torch.Tensor) -> torch.Tensor:
    """Return the Pearson correlation of each image (n, H, W) with `reference` (H, W) over all circular shifts.

    Returns:
        (n, 2, H, W): without rotation, and rotated by 180 degrees.
    """
    both = torch.stack((image, rotate_180(image)), 1)
    both = both - both.mean((-2, -1), keepdim=True)
    reference = reference - reference.mean()
    spectrum = torch.fft.rfft2(reference) * torch.fft.rfft2(both).conj()
    norm = reference.norm() * torch.linalg.vector_norm(both, dim=(-2, -1), keepdim=True)
    return torch.fft.irfft2(spectrum, s=reference.shape) / norm.clamp_min(1e-30)


def register_images(image: torch.Tensor, reference: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Shift each image of a batch (n, H, W), and rotate it by 180 degrees if needed, to fit `reference` (H, W).

    Returns:
        the registered images (whole-pixel circular shifts), and their Pearson correlation with the reference, (n,).
    """
    height, width = reference.shape
    value, place = correlation_maps(image, reference).flatten(1).max(1)
    moved = []
    for one, best in zip(image, place.tolist(), strict=True):
        turn, shift = divmod(best, height * width)
        moved.append(torch.roll(rotate_180(one) if turn else one, divmod(shift, width), (0, 1)))
    return torch.stack(moved), value


def pairwise_correlation(images: torch.Tensor) -> torch.Tensor:
    """Return the Pearson correlation of images (n, H, W) with each other after registration; (n, n), where image i is the
    reference of row i.
    """
    return torch.stack([register_images(images, one)[1] for one in images])


def register_groups(pictures: torch.Tensor, references: torch.Tensor) -> torch.Tensor:
    """Register groups of images (n, k, 64, 64) so that the first image of each group fits its reference (n, 64, 64).

    Parts outside the window are lost, so the correlation at each shift is multiplied by the fourth power of the fraction of
    the light that it keeps.
    """
    shown = references.shape[-1]
    side, grid = 2 * shown, (2 * shown, 2 * shown)
    ours, theirs = torch.fft.rfft2(pictures[:, 0], s=grid), torch.fft.rfft2(references, s=grid)
    window = torch.fft.rfft2(torch.ones_like(references), s=grid)
    # the twin image has the conjugate spectrum
    both = torch.stack((ours.conj(), ours), 1)
    fit = torch.fft.irfft2(theirs[:, None] * both, s=grid)
    mass = pictures[:, 0].sum((-2, -1)).clamp_min(1e-12)[:, None, None, None]
    kept = torch.fft.irfft2(window[:, None] * both, s=grid).clamp_min(0.0) / mass
    moved = []
    for own, best in zip(pictures, (fit * kept**4).flatten(1).argmax(1).tolist(), strict=True):
        turn, shift = divmod(best, side * side)
        whole = zero_pad(own)
        moved.append(torch.roll(rotate_180(whole) if turn else whole, divmod(shift, side), (-2, -1))[:, :shown, :shown])
    return torch.stack(moved)


def crop_centred(images: torch.Tensor, side: int | None = None) -> torch.Tensor:
    """Crop the `side` x `side` window (default: half of the images) that contains most of the light of periodic images (...,
    H, W), taken together, and centre them.
    """
    side = images.shape[-1] // 2 if side is None else side
    for dimension in (-2, -1):
        profile = images.movedim(dimension, 0).flatten(1).sum(1).double()
        length = profile.numel()
        window = torch.cat((profile, profile)).cumsum(0)
        held = window[side - 1 : side - 1 + length] - torch.cat((window.new_zeros(1), window))[:length]
        # All window positions that contain nearly everything form a circular range, whose middle centres the object.
        full = held >= held.max() - 2e-3 * profile.sum().abs()
        angle = torch.arange(length, device=images.device) * (2.0 * torch.pi / length)
        middle = torch.atan2((full * angle.sin()).sum(), (full * angle.cos()).sum()) * length / (2.0 * torch.pi)
        images = torch.roll(images, -round(float(middle)), dimension)
    return images[..., :side, :side]


def centre_each(albedos: torch.Tensor, side: int | None = None) -> torch.Tensor:
    """Centre each of n albedos (n, H, H) in its own window, (n, side, side); see `crop_centred`."""
    return torch.stack([crop_centred(one, side) for one in zero_pad(albedos)])


@dataclass(frozen=True)
class Consensus:
    """Registered mean (H, W) of reconstructions, their mean correlation (0 to 1), and its decay with spatial frequency.

    `transfer` is the phase retrieval transfer function (Chapman et al., J. Opt. Soc. Am. A 23, 1179, 2006,
    doi:10.1364/JOSAA.23.001179): |mean of F| over mean of |F|, averaged on rings of 0, 1, 2 ... cycles per window of the object. It is 1
    if all have the same phase, and 1 / sqrt(n) for n independent phases.
    """

    image: torch.Tensor
    agreement: float
    transfer: tuple[float, ...]


def consensus(images: torch.Tensor, residual: torch.Tensor, best: int = 8, alike: float = 0.7) -> Consensus:
    """Combine the `best` starts (n, H, W) with the lowest residuals.

    The reference is the start that correlates most with the others, not the one with the lowest residual, which often fits the noise
    best. Starts whose correlation with the reference is below the fraction `alike` of the highest are excluded from the mean, but not
    from the mean correlation.
    """
    chosen = images[residual.argsort(stable=True)[:best]]
    mutual = pairwise_correlation(chosen)
    aligned, correlation = register_images(chosen, chosen[mutual.sum(1).argmax()])
    count = len(chosen)
    others = (mutual.sum() - mutual.diagonal().sum()) / (count * (count - 1)) if count > 1 else mutual.new_ones(())
    mean = mean_of_agreeing(aligned, correlation, alike)
    return Consensus(mean, float(others.clamp(0.0, 1.0)), phase_retrieval_transfer(aligned))


def mean_of_agreeing(aligned: torch.Tensor, correlation: torch.Tensor, alike: float = 0.7) -> torch.Tensor:
    """Average registered images (n, H, W) whose correlation (n,) with the reference is at least the fraction `alike` of
    the highest."""
    return aligned[correlation >= alike * correlation.max()].mean(0)


def phase_retrieval_transfer(aligned: torch.Tensor) -> tuple[float, ...]:
    """Return the phase retrieval transfer function of registered images (n, H, W); see `Consensus`."""
    spectra = torch.fft.rfft2(aligned)
    ratio = spectra.mean(0).abs() / spectra.abs().mean(0).clamp_min(1e-30)
    row = torch.fft.fftfreq(aligned.shape[-2], device=aligned.device)[:, None]
    column = torch.fft.rfftfreq(aligned.shape[-1], device=aligned.device)
    window = aligned.shape[-1] // 2
    ring = (torch.hypot(row, column) * window).round().long().flatten()
    total = torch.zeros(window, device=aligned.device).scatter_add_(0, ring, ratio.flatten())
    count = torch.zeros(window, device=aligned.device).scatter_add_(0, ring, torch.ones_like(ratio).flatten())
    return tuple((total / count.clamp_min(1.0))[: window // 2 + 1].tolist())
