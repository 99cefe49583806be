"""Wiener filter of counts: the intensity that the search fits, and the prediction that a field has to surpass."""

from __future__ import annotations

import torch
from torch.nn import functional

from invert.field.counts import FrameCounts
from invert.field.forward_model import ForwardModel


def intensity_spectrum(prior: torch.Tensor, model: ForwardModel, modes: int = 1) -> torch.Tensor:
    """Return the power spectrum of the speckle intensity at the frequencies of an rfft2 of the periodic grid, for a mean
    intensity of 1 and orthonormal transforms: the autocorrelation of the prior (Goodman, Speckle Phenomena in Optics, Eq. 5-60), over the
    number of polarisation modes.
    """
    rows, columns = model.grid.shape
    spectrum = torch.fft.rfft2(prior / prior.sum(), s=(rows, columns))
    lags = torch.fft.irfft2(spectrum.real.square() + spectrum.imag.square(), s=(rows, columns))
    return lags[:, : columns // 2 + 1].clamp_min(0.0) * (rows * columns / modes)


def variance_transfer(spectrum: torch.Tensor, model: ForwardModel) -> float:
    """Return the fraction of the speckle's variance that the camera transmits; see `intensity_spectrum`."""
    rows, columns = model.grid.shape
    kept = (spectrum * model.transfer.square()).double()
    kept[0, 0] = 0.0
    both = 2.0 * kept.sum() - kept[:, 0].sum() - (kept[:, -1].sum() if columns % 2 == 0 else 0.0)
    return float(both) / (rows * columns)


def filter_counts(counts: FrameCounts, spectrum: torch.Tensor, model: ForwardModel) -> torch.Tensor:
    """Return the intensity on the periodic grid, background subtracted and H deconvolved; only fitted pixels enter.

    Args:
        spectrum: from `intensity_spectrum`.
    """
    scaled = (counts.values - counts.background) / counts.illumination
    weight = counts.fitted.to(scaled.dtype)
    filled = torch.where(counts.fitted, scaled, _local_mean(scaled * weight, weight)) - counts.signal
    padded = filled.new_zeros(model.grid.shape)
    model.grid.on_frame(padded).copy_(filled)
    strength = counts.signal**2 * spectrum
    noise = counts.signal + counts.background + counts.roughness * counts.mean_square
    gain = strength * model.transfer / (strength * model.transfer.square() + noise)
    return (torch.fft.irfft2(torch.fft.rfft2(padded) * gain, s=model.grid.shape) + counts.signal).clamp_min_(0.0)


def _local_mean(weighted: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Return the mean of the fitted pixels among the nine around each pixel; the mean of the frame where there are none."""
    total, count = (functional.avg_pool2d(one[None], 3, 1, 1)[0] for one in (weighted, weight))
    return torch.where(count > 0.0, total / count.clamp_min(1e-6), weighted.sum() / weight.sum())
