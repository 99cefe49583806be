"""Log-likelihood of albedos under the Gamma noise model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch
from scipy.special import digamma

from correlograph.lags import lag_grid
from invert.measure.spectrum import Measurement
from radiometry.noise.model import autocorrelate_windowed

PEDESTAL_SIGMA = 0.5
"""Standard deviation of the pedestal of an estimate in units of the window of the object. Lab estimates contain such
an excess, 1 to 4 % of the maximum lag, of unknown origin. A model without it favours smeared albedos."""

MIN_FLOOR = 1e-3
"""Minimum floor in units of the maximum lag; model errors of this size occur with any albedo."""


@lru_cache(maxsize=8)
def lags_used(lags: int) -> torch.Tensor:
    """Return a mask of the lags used, bool (127, 127); those adjacent to zero lag carry little information."""
    grid = lag_grid(lags)
    return torch.from_numpy((grid.ring > 1) & grid.half_plane)


@lru_cache(maxsize=8)
def pedestal_profile(lags: int) -> torch.Tensor:
    """Return the pedestal at every lag, float64 (127, 127), 1 at zero lag."""
    grid = lag_grid(lags)
    profile = torch.exp(-0.5 * (torch.from_numpy(grid.steps).double() / (PEDESTAL_SIGMA * grid.object_side)).square())
    return torch.outer(profile, profile)


class NoiseLikelihood:
    """Log-likelihood of one measurement as a function of its object; differentiable.

    The noise model is Gamma of shape K with mean S = a H (r*r) + c p + b. Floor b (at least `MIN_FLOOR`) and K (1 without noise, which
    keeps the order) are read from the estimate, and p is a wide pedestal. The gains a and c, zero or more, are fitted for each albedo
    (weighted least squares, weights 1 / S^2, repeated). For correlated lags, K is divided by the variance inflation of their sums.

    Args:
        kind: dtype of the computation.
        transfer: H per lag (127, 127) of a measurement that was not divided by it.
    """

    def __init__(
        self,
        measurement: Measurement,
        device: torch.device | str = "cpu",
        kind: torch.dtype = torch.float64,
        transfer: np.ndarray | None = None,
    ) -> None:
        lags = measurement.lag_grid.lags
        self._used, self._pedestal = lags_used(lags).to(device), pedestal_profile(lags)[lags_used(lags)].to(device, kind)
        estimate = torch.from_numpy(measurement.estimate).to(device, kind)[self._used]
        tiny = torch.finfo(kind).tiny
        height = estimate.abs().amax().clamp_min(tiny)
        self._estimate, self._floor = estimate / height, max(measurement.noise.floor / float(height), MIN_FLOOR)
        self.inflation = measurement.noise.inflation
        self._dof = (measurement.noise.dof or 1.0) / self.inflation
        self._transfer = 1.0 if transfer is None else torch.from_numpy(transfer).to(device, kind)[self._used]

    @property
    def lags(self) -> int:
        """Number of lags used: one of every pair."""
        return len(self._estimate)

    def __call__(self, albedo: torch.Tensor) -> torch.Tensor:
        """Return the log-likelihood of each albedo (n, 64, 64), up to an additive constant; (n,)."""
        return self.by_lag(albedo).sum(1)

    def misfit(self, albedo: torch.Tensor) -> float:
        """Return the log-likelihood deficit (nats) of an albedo (64, 64) against the saturated model, minus its
        expectation under noise."""
        likeliest = self._estimate.clamp_min(self._floor)
        best = -self._dof * float((likeliest.log() + self._estimate / likeliest).sum())
        dof = self._dof * self.inflation
        by_noise = self._dof * (math.log(dof) - float(digamma(dof))) * int((self._estimate > self._floor).sum())
        return best - by_noise - float(self(albedo[None])[0])

    def by_lag(self, albedo: torch.Tensor, weight: torch.Tensor | None = None) -> torch.Tensor:
        """Return the contribution of each lag to the log-likelihood of each albedo, (n, lags).

        Args:
            weight: weight of each lag, (lags,) or (n, lags), in the fit of the gains.
        """
        weight = torch.ones_like(self._estimate) if weight is None else weight
        signal = autocorrelate_windowed(albedo.to(self._estimate.dtype))[:, self._used] * self._transfer
        signal = signal / signal.detach().amax(1, keepdim=True).clamp_min(torch.finfo(signal.dtype).tiny)
        bright, faint = fit_brightnesses(signal, self._pedestal, self._estimate, self._floor, weight, 8)
        expected = self._floor + bright[:, None] * signal + faint[:, None] * self._pedestal
        return -self._dof * (expected.log() + self._estimate / expected)


@torch.no_grad()
def log_likelihoods(albedo: torch.Tensor, measurement: Measurement) -> torch.Tensor:
    """Return the log-likelihood of a measurement for each albedo (n, 64, 64), up to an additive constant; (n,)."""
    return NoiseLikelihood(measurement, albedo.device)(albedo)


def log_likelihood_leads(reference: np.ndarray, albedo: np.ndarray, captures: Sequence[Measurement]) -> list[float]:
    """Return the lead in log-likelihood (nats) of `albedo` over `reference`, for each of several captures of the object.

    The captures must not be those of the reconstructions; their noise is then fitted by neither.
    """
    both = torch.from_numpy(np.stack((albedo, reference)))
    likelihoods = [log_likelihoods(both, capture) for capture in captures]
    return [float(ours - theirs) for ours, theirs in likelihoods]


@torch.no_grad()  # the likelihood is stationary at the fitted gains
def fit_brightnesses(
    signal: torch.Tensor,
    pedestal: torch.Tensor,
    estimate: torch.Tensor,
    floor: torch.Tensor | float,
    weight: torch.Tensor,
    rounds: int,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Fit the gains a and c (n,) of object and pedestal by weighted least squares, repeated with weights over the squared expectation.

    Args:
        signal: r*r of each object, (n, lags); the other arguments broadcast to this shape.
    """
    expected = torch.zeros_like(signal) + floor
    for _ in range(rounds):
        bright, faint = _least_squares_brightnesses(signal, pedestal, estimate - floor, weight * expected.square().reciprocal())
        expected = floor + bright[:, None] * signal + faint[:, None] * pedestal
    return bright, faint


def _least_squares_brightnesses(
    signal: torch.Tensor, pedestal: torch.Tensor, excess: torch.Tensor, weight: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return gains a, c (n,), zero or more, that fit a * signal (n, lags) + c * pedestal to an excess by weighted least
    squares."""
    limits = torch.finfo(signal.dtype)
    ss, pp = (weight * signal.square()).sum(1).clamp_min(limits.tiny), (weight * pedestal.square()).sum(1)
    sp, se, pe = ((weight * one * other).sum(1) for one, other in ((signal, pedestal), (signal, excess), (pedestal, excess)))
    faint = (pe - sp * (se / ss)) / (pp - sp * (sp / ss)).clamp_min(16.0 * limits.eps * pp)
    # if the best signal would be negative, the pedestal is fitted alone
    faint = torch.minimum(faint, pe / pp).clamp_min(0.0)
    return ((se - sp * faint) / ss).clamp_min(0.0), faint
