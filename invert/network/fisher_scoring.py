"""Fisher scoring of albedos: gradient and curvature of the likelihood in the pixels, and data-consistency steps."""

from __future__ import annotations

from functools import lru_cache

import torch

from correlograph.lags import lag_grid_of
from invert.likelihood.gamma import MIN_FLOOR, fit_brightnesses, lags_used, pedestal_profile
from invert.network.features import DOF_RANGE, Observation, fill_zero_lag_by_neighbours, zero_lag_first
from radiometry.autocorrelation import window_kernel


def _half(lags: torch.Tensor) -> torch.Tensor:
    """Return the lags (n, 127, 127) of rows 0 to 63, zero lag first, (n, 64, 128); the other rows mirror these."""
    return zero_lag_first(lags)[..., : lag_grid_of(lags).object_side, :]


@lru_cache(maxsize=8)
def _constants(lags: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the mask of the lags and the pedestal, (1, 64, 128) each, and the spectral response of the patch window, (128, 65)."""
    response = torch.fft.fft(zero_lag_first(torch.from_numpy(window_kernel(lags))[None])[0, :, 0]).real
    window = torch.outer(response, response[: lags + 2]).float()
    return _half(lags_used(lags).float()[None]), _half(pedestal_profile(lags).float()[None]), window


MAX_ALBEDO = 1.2
"""Maximum albedo of a step; the maximum of an object is about 1."""

MAX_STEP_LENGTH = 1.0
"""Maximum step length in units of the steps of individual pixels."""


class Likelihood:
    """The likelihood of `invert.likelihood.gamma` for n estimates at once."""

    def __init__(self, seen: Observation) -> None:
        estimate = fill_zero_lag_by_neighbours(seen.estimate)
        height = estimate.abs().amax((-2, -1)).clamp_min(1e-30)
        self.estimate = _half(estimate / height[:, None, None])
        self.floor = (seen.floor / height).clamp_min(MIN_FLOOR)[:, None, None]
        self.dof = seen.dof.clamp(*DOF_RANGE)[:, None, None]
        self.used, self.pedestal, self.window = (one.to(estimate) for one in _constants(lag_grid_of(seen.estimate).lags))

    def at(self, albedo: torch.Tensor) -> LikelihoodPoint:
        """Evaluate the likelihood at one albedo per estimate, (n, 64, 64)."""
        return LikelihoodPoint(self, albedo)


class LikelihoodPoint:
    """A likelihood at albedos (n, 64, 64), with its derivatives.

    The gains of object and pedestal are fitted. The gradient is zero at an albedo of zeros.

    Attributes:
        deviance: reduced deviance per lag, (n,): 1 at the truth, more if signal is unexplained.
    """

    def __init__(self, likelihood: Likelihood, albedo: torch.Tensor) -> None:
        estimate, floor, used, pedestal = likelihood.estimate, likelihood.floor, likelihood.used, likelihood.pedestal
        self._window, self._albedo, self._spectrum = likelihood.window, albedo, _spectrum(albedo)
        self._lags = used.sum()
        signal = self._smooth_by_window(self._spectrum.abs().square())
        scale = (signal * used).amax((-2, -1)).clamp_min(1e-6)[:, None, None]
        signal = signal / scale
        bright, faint = fit_brightnesses(
            signal.flatten(1), pedestal.flatten(), estimate.flatten(1), floor.flatten(1), used.flatten(), 3
        )
        expected = floor + bright[:, None, None] * signal + faint[:, None, None] * pedestal
        self._gain = bright[:, None, None] / scale
        self._weight = used * likelihood.dof * self._gain / expected.square()
        self._excess = estimate - expected
        ratio = (estimate / expected).clamp_min(1e-3)
        self.deviance = (2.0 * used * likelihood.dof * (ratio - 1.0 - ratio.log())).sum((-2, -1)) / self._lags

    def log_likelihood(self) -> torch.Tensor:
        """Return the log-likelihood of the albedos, (n,), in nats, up to a constant."""
        return -0.5 * self._lags * self.deviance

    def gradient(self) -> torch.Tensor:
        """Return the gradient of the log-likelihood, (n, 64, 64)."""
        return self._in_picture(self._weight * self._excess, self._spectrum)

    def information(self) -> torch.Tensor:
        """Return the Fisher information of each pixel, (n, 64, 64), at fixed gains; accurate to a factor of two, because
        the correlation of opposite lags is neglected."""
        return self._in_picture(self._weight * self._gain, _spectrum(self._albedo.square())).clamp_min(1e-6)

    def curvature(self, change: torch.Tensor) -> torch.Tensor:
        """Return the Fisher information matrix at fixed gains times a change of the albedo, (n, 64, 64)."""
        of_signal = self._smooth_by_window(2.0 * (self._spectrum.conj() * _spectrum(change)).real)
        return self._in_picture(self._weight * self._gain * of_signal, self._spectrum)

    def _smooth_by_window(self, power: torch.Tensor) -> torch.Tensor:
        """Return half of the lags of a power spectrum (n, 128, 65), smoothed by the patch window."""
        side = len(self._window)
        return torch.fft.irfft2(power * self._window, s=(side, side))[..., : side // 2, :]

    def _in_picture(self, lags: torch.Tensor, spectrum: torch.Tensor) -> torch.Tensor:
        """Smooth lags, and convolve them with images given by their spectra; (n, 64, 64).

        d (r*r)(lag) / d r(x) = r(x + lag) + r(x - lag).
        """
        side = len(self._window)
        both = 2.0 * self._window * torch.fft.rfft2(lags, s=(side, side)).real
        return torch.fft.irfft2(both * spectrum, s=(side, side))[..., : side // 2, : side // 2]


def run_data_consistency_steps(
    seen: Observation, albedo: torch.Tensor, variance: torch.Tensor, steps: int, explained: float = 0.0
) -> torch.Tensor:
    """Move albedos (n, 64, 64) up their likelihood given their estimates, under a Gaussian prior around the initial values.

    Each is a preconditioned conjugate-gradient step whose length follows from the curvature. Dark pixels stay dark if their gradient is
    negative.

    Args:
        variance: variance of the prior, (n,).
        explained: reduced deviance below which an albedo remains unchanged, because the rest may be noise.
    """
    begun, precision = albedo, variance.reciprocal()[:, None, None]
    likelihood = Likelihood(seen)
    at = likelihood.at(albedo)
    preconditioner = (at.information() + precision).reciprocal()
    direction = former = torch.zeros_like(albedo)
    former_norm = torch.ones_like(precision)
    for step in range(steps):
        at = likelihood.at(albedo) if step else at
        if bool((at.deviance <= explained).all()):
            break
        slope = at.gradient() + precision * (begun - albedo)
        slope = slope * ((albedo > 0.0) | (slope > 0.0)) * (at.deviance > explained)[:, None, None]
        steepest = preconditioner * slope
        conjugate = (_dot(slope - former, steepest) / former_norm).clamp_min(0.0)  # Polak and Ribiere
        direction = steepest + conjugate * direction * (slope != 0.0)
        direction = torch.where(_dot(direction, slope) > 0.0, direction, steepest)
        former, former_norm = slope, _dot(slope, steepest).clamp_min(1e-30)
        bend = _dot(direction, at.curvature(direction) + precision * direction).clamp_min(1e-30)
        length = (_dot(slope, direction) / bend).clamp_max(MAX_STEP_LENGTH)
        albedo = (albedo + length * direction).clamp(0.0, MAX_ALBEDO)
    return albedo


def _spectrum(albedo: torch.Tensor) -> torch.Tensor:
    side = 2 * albedo.shape[-1]
    return torch.fft.rfft2(albedo, s=(side, side))


def _dot(one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    return (one * other).sum((-2, -1), keepdim=True)
