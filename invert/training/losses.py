"""Losses that are invariant to shift and twin image, and the loss of the denoiser.

They are the four of Metzler et al. 2020 (section 5.B), the negative Pearson correlation of autocorrelations, and the registered
loss, which compares objects. Losses on r*r alone accept a bright point with a faint copy of the object.
"""

from __future__ import annotations

import torch

from correlograph.lags import lag_grid_of
from invert.likelihood.forward_model import zero_lag_first


def spectrum(albedo: torch.Tensor) -> torch.Tensor:
    """Return F(r) of albedos (n, 64, 64), zero-padded so that lags do not wrap; (n, 128, 65)."""
    side = 2 * albedo.shape[-1]
    return torch.fft.rfft2(albedo, s=(side, side))


def _lags(transform: torch.Tensor) -> torch.Tensor:
    """Return r*r from F(r), in units of its value at zero lag."""
    side = transform.shape[-2]
    lags = torch.fft.irfft2(transform.real.square() + transform.imag.square(), s=(side, side))
    return lags / lags[:, :1, :1].clamp_min(1e-12)


def registered_pearson(albedo: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Return the Pearson correlation with the truth after the best shift and rotation by 180 degrees, (n,), of (n, 64,
    64) each."""
    ours, theirs = spectrum(albedo), spectrum(truth)
    # the twin image has the conjugate spectrum
    maps = torch.fft.irfft2(torch.stack((ours * theirs.conj(), ours * theirs), 1), s=ours.shape[-2:-1] * 2)
    count = albedo[0].numel()
    product = maps.flatten(1).amax(1) / count - albedo.mean((-2, -1)) * truth.mean((-2, -1))
    variance = albedo.var((-2, -1), correction=0) * truth.var((-2, -1), correction=0)
    return product / (variance + 1e-12).sqrt()


def registered_loss(albedo: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Return 1 - registered correlation, plus a fifth of the relative autocorrelation error; (n,)."""
    return 1.0 - registered_pearson(albedo, truth) + 0.2 * autocorrelation_l1(albedo, truth)


def autocorrelation_l1(albedo: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Return the L1 error of the reconstruction's autocorrelation relative to the true one, as in Metzler et al. 2020; (n,)."""
    ours, theirs = _lags(spectrum(albedo)), _lags(spectrum(truth))
    return (ours - theirs).abs().sum((-2, -1)) / theirs.sum((-2, -1))


def autocorrelation_l2(albedo: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    ours, theirs = _lags(spectrum(albedo)), _lags(spectrum(truth))
    return (ours - theirs).square().sum((-2, -1)).add(1e-12).sqrt() / theirs.square().sum((-2, -1)).sqrt()


def autocorrelation_pearson(albedo: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Return 1 - Pearson correlation of the autocorrelations; (n,)."""
    both = torch.stack((_lags(spectrum(albedo)), _lags(spectrum(truth))))
    both = both - both.mean((-2, -1), keepdim=True)
    return 1.0 - (both[0] * both[1]).sum((-2, -1)) / both.square().sum((-2, -1)).prod(0).add(1e-12).sqrt()


def _moduli(albedo: torch.Tensor) -> torch.Tensor:
    transform = spectrum(albedo)
    energy = albedo.square().sum((-2, -1)).clamp_min(1e-9)[:, None, None]
    return ((transform.real.square() + transform.imag.square() + 1e-9) / energy).sqrt()


def modulus_l1(albedo: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    ours, theirs = _moduli(albedo), _moduli(truth)
    return (ours - theirs).abs().sum((-2, -1)) / theirs.sum((-2, -1))


def modulus_l2(albedo: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    ours, theirs = _moduli(albedo), _moduli(truth)
    return (ours - theirs).square().sum((-2, -1)).add(1e-12).sqrt() / theirs.square().sum((-2, -1)).sqrt()


def noise_left(found: torch.Tensor, signal: torch.Tensor, measured: torch.Tensor) -> torch.Tensor:
    """Return the logarithm of the fraction of error that denoising leaves: geometric mean over lags and Fourier modulus.

    Args:
        found, signal, measured: denoised, true, and measured without its floor, (n, 127, 127).

    Returns:
        (n,): 0 without improvement, log(1/2) if both errors are halved.
    """
    scale = signal.amax((-2, -1)).clamp_min(measured.square().mean((-2, -1)).sqrt())[:, None, None]
    found, signal, measured = found / scale, signal / scale, measured.clone() / scale
    middle = lag_grid_of(signal).lags
    measured[:, middle, middle] = signal[:, middle, middle]  # zero lag is never measured
    shares = []
    for view in (lambda lags: lags, _lags_modulus):
        ours, theirs, begun = view(found), view(signal), view(measured)
        left = (ours - theirs).square().sum((-2, -1)) / (begun - theirs).square().sum((-2, -1)).clamp_min(1e-12)
        shares.append(left.add(1e-4).log())
    return 0.25 * (shares[0] + shares[1])


def _lags_modulus(lags: torch.Tensor) -> torch.Tensor:
    """Return |F(r)| from r*r (n, 127, 127), zero lag in the middle; (n, 128, 65)."""
    spectrum = torch.fft.rfft2(zero_lag_first(lags)).real
    return (spectrum.clamp_min(0.0) + 1e-2).sqrt()


LOSSES = {
    "registered": registered_loss,
    "autocorrelation-l1": autocorrelation_l1,
    "autocorrelation-l2": autocorrelation_l2,
    "modulus-l1": modulus_l1,
    "modulus-l2": modulus_l2,
    "pearson": autocorrelation_pearson,
}
