"""Noise model: S = H (r*r) + b, and the scatter of an estimate with K degrees of freedom around S.

Two corrections of Metzler et al. 2020, Eqs. (10) and (11): their S = H (r*r + b) filters shot noise, which is white after the
pupil, and the last line of Eq. (11) omits the cross term of S^2. Mean periodograms of circular Gaussian spectra are exactly
Gamma-distributed with mean S and shape K (Bartlett; Welch, doi:10.1109/TAU.1967.1161901); the Gaussian of Eq. (10) is their limit
for large K.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
import torch

from correlograph.errors import InputError
from radiometry.autocorrelation import window_kernel

Form = Literal["gamma", "gaussian"]


def expected_spectrum(signal: torch.Tensor, floor: torch.Tensor | float, transfer: torch.Tensor | None = None) -> torch.Tensor:
    """Return S = H (r*r) + b.

    Args:
        signal: r*r, (..., 127, 127), in any unit, smoothed by the window or not.
        floor: b in the same unit, a number or (...,).
        transfer: H per lag (127, 127); 1 if None.
    """
    if not torch.is_tensor(floor):
        floor = torch.as_tensor(floor, dtype=signal.dtype, device=signal.device)
    filtered = signal if transfer is None else signal * transfer
    return filtered + floor[..., None, None]


def autocorrelate_windowed(albedo: torch.Tensor) -> torch.Tensor:
    """Return r*r of albedos (..., n, n), one square cell per lag, smoothed by boxcar patches: (..., 2n - 1, 2n - 1),
    summed over cells."""
    n = 2 * albedo.shape[-1]
    power = torch.fft.rfft2(albedo, s=(n, n)).abs().square()
    lags = torch.fft.fftshift(torch.fft.irfft2(power, s=(n, n)), dim=(-2, -1))[..., 1:, 1:]
    kernel = torch.from_numpy(window_kernel(albedo.shape[-1] - 1)).to(lags)
    smooth = kernel @ lags @ kernel.T
    return 0.5 * (smooth + smooth.flip((-2, -1)))  # exactly centro-symmetric in spite of rounding


def lag_correlation(distance: np.ndarray) -> np.ndarray:
    """Return the correlation of the noise of lags at a distance along one axis, for an estimate from all pixel pairs.

    It is the Fourier transform of the squared patch triangle: 1 at n = 0, then 3 / (2 pi^2 n^2) for lags that are n apart,
    which is 0.152 for neighbours. The values along both axes multiply.
    """
    apart = np.abs(distance)
    return np.where(apart == 0, 1.0, 1.5 / (np.pi * np.maximum(apart, 1)) ** 2)


@lru_cache(maxsize=4)
def _correlating_filter(side: int) -> torch.Tensor:
    """Return the square root of the spectrum of `lag_correlation` on a periodic grid, (side, side // 2 + 1)."""
    step = np.arange(side)
    power = np.fft.fft(lag_correlation(np.minimum(step, side - step))).real.clip(0.0)
    return torch.from_numpy(np.sqrt(np.outer(power, power[: side // 2 + 1])))


def _correlated_normal(shape: torch.Size, rng: torch.Generator) -> torch.Tensor:
    """Sample normal variates (..., n, n) with the correlation `lag_correlation`, equal at +lag and -lag; zero lag has
    variance 2."""
    side = shape[-1] + 1
    white = torch.randn((*shape[:-2], side, side), generator=rng, dtype=torch.float64, device=rng.device)
    filtered = torch.fft.irfft2(torch.fft.rfft2(white) * _correlating_filter(side).to(white), s=(side, side))[..., :-1, :-1]
    return (filtered + filtered.flip((-2, -1))) / 2.0**0.5


def draw_estimate(
    spectrum: torch.Tensor, dof: torch.Tensor | float, rng: torch.Generator, form: Form = "gamma", *, correlated: bool = False
) -> torch.Tensor:
    """Sample a centro-symmetric noisy estimate with mean S; both signs of a lag carry the same noise.

    Args:
        spectrum: S (..., n, n), n odd, zero lag in the middle.
        dof: K, a number or (...,), above zero.
        form: `gamma`, exact; or `gaussian`, Metzler et al. 2020, Eq. (10): N(S, S^2 / K), which can be negative.
        correlated: whether lags are correlated like those of whole frames (`lag_correlation`) or independent like those of
            non-overlapping patches. Correlated Gamma variates are Wilson and Hilferty's cubes of normal ones
            (doi:10.1073/pnas.17.12.684), whose variance has a relative error of 2 / (9 K).

    Zero lag is real-valued in the spectrum and has K / 2 degrees of freedom in the `gamma` form.
    """
    shape = torch.as_tensor(dof, dtype=torch.float64, device=spectrum.device)
    if not bool((shape > 0.0).all()):
        raise InputError("dof", "degrees of freedom above zero", dof, "take at least two frames or patches")
    shape = shape[..., None, None].expand(spectrum.shape).contiguous()
    if correlated:
        normal = _correlated_normal(spectrum.shape, rng).to(spectrum.device)
        if form == "gaussian":
            return (spectrum * (1.0 + normal / shape.sqrt())).to(spectrum.dtype)
        return (spectrum * (1.0 - 1.0 / (9.0 * shape) + normal / (3.0 * shape.sqrt())).clamp_min(0.0) ** 3).to(spectrum.dtype)
    if form == "gaussian":
        noise = torch.randn(spectrum.shape, generator=rng, dtype=torch.float64, device=spectrum.device)
        factor = 1.0 + noise / shape.sqrt()
    else:
        middle = spectrum.shape[-1] // 2
        shape[..., middle, middle] *= 0.5
        factor = _standard_gamma(shape, rng) / shape
    flat = factor.flatten(-2)
    count = flat.shape[-1]
    # The second half of the lags is the reversed first half.
    flat[..., count // 2 + 1 :] = flat[..., : count // 2].flip(-1)
    return (spectrum * factor).to(spectrum.dtype)


def _standard_gamma(shape: torch.Tensor, rng: torch.Generator) -> torch.Tensor:
    """Sample Gamma variates of a shape and scale 1 with numpy's generator, seeded by torch's."""
    seed = int(torch.randint(2**62, (), generator=rng, device=rng.device))
    return torch.from_numpy(np.random.default_rng(seed).standard_gamma(shape.cpu().numpy())).to(shape.device)


def log_likelihood(estimate: torch.Tensor, spectrum: torch.Tensor, dof: float, form: Form = "gamma") -> torch.Tensor:
    """Return the log-likelihood of an estimate, summed over one half of its lags without zero lag; (...,)."""
    half = estimate.shape[-1] ** 2 // 2
    measured, expected = estimate.flatten(-2)[..., :half].double(), spectrum.flatten(-2)[..., :half].double()
    shape = torch.tensor(dof, dtype=torch.float64)
    if form == "gaussian":
        variance = expected.square() / shape
        terms = -0.5 * ((measured - expected).square() / variance + torch.log(2.0 * torch.pi * variance))
    else:
        ratio = measured / expected
        terms = (
            shape * torch.log(shape)
            - torch.lgamma(shape)
            + (shape - 1.0) * torch.log(ratio)
            - shape * ratio
            - torch.log(expected)
        )
    return terms.sum(-1)
