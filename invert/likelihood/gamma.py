"""Log-likelihood of albedos under the Gamma noise model, with its gradient and its Fisher information."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np
import torch
from scipy.special import digamma

from correlograph.lags import lag_grid_of
from invert.likelihood.forward_model import ForwardModel, fit_gains, half_of, lags_used, pedestal_profile
from invert.measure.spectrum import Measurement

MIN_FLOOR = 1e-3
"""Minimum floor in units of the maximum lag; model errors of this size occur with any albedo."""

MIN_ESTIMATE = 1e-6
"""Minimum of an estimate, in units of its maximum, for which the perfect fit is computed; estimates can be zero."""

ROUNDS, FAST_ROUNDS = 8, 3
"""Rounds of the fit of the gains."""


class Likelihood:
    """Log-likelihood of n estimates as a function of one albedo each, or of one estimate as a function of many albedos.

    The noise model is Gamma of shape K with mean S = a H (r*r) + c p + b; see `invert.likelihood.forward_model`. The gains a
    and c, zero or more, are fitted for each albedo. Because neighbouring lags are correlated, K is divided by the factor by
    which this correlation increases the variance of sums over lags.

    Args:
        estimate: (n, 127, 127), zero lag in the middle; sets the device and the type of the computation.
        floor: b of each, (n,); at least `MIN_FLOOR` of the maximum is assumed.
        dof: K of each, (n,).
        inflation: variance inflation of sums over lags.
        exact: whether albedos may fill the window (see `ForwardModel`), and whether what the assumed floor exceeds b by is added to the
            estimate, too, which would lie below every expectation otherwise. Networks were trained without.
        transfer: H per lag (127, 127) of an estimate that was not divided by it.
    """

    def __init__(
        self,
        estimate: torch.Tensor,
        floor: torch.Tensor,
        dof: torch.Tensor,
        *,
        inflation: float = 1.0,
        exact: bool = False,
        transfer: np.ndarray | None = None,
    ) -> None:
        lags = lag_grid_of(estimate).lags
        half = half_of(estimate).clone()
        half[:, 0, 0] = 0.0  # zero lag holds the mean brightness
        height = half.abs().amax((-2, -1)).clamp_min(torch.finfo(half.dtype).tiny)
        relative = (floor / height)[:, None, None]
        self.floor = relative.clamp_min(MIN_FLOOR)
        self.values = half / height[:, None, None] + (self.floor - relative if exact else 0.0)
        self.dof, self.inflation = dof[:, None, None] / inflation, inflation
        self.used, self.pedestal = lags_used(lags).to(half), pedestal_profile(lags).to(half)
        self.model = ForwardModel(lags, half, exact=exact, transfer=transfer)
        self.rounds = ROUNDS if exact else FAST_ROUNDS

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        device: torch.device | str = "cpu",
        kind: torch.dtype = torch.float64,
        transfer: np.ndarray | None = None,
    ) -> Likelihood:
        """Return the likelihood of one measurement. For an estimate without noise, K is set to 1, which does not change the
        ranking of albedos by likelihood.
        """
        noise = measurement.noise
        estimate = torch.from_numpy(measurement.values).to(device, kind)[None]
        floor, dof = (torch.tensor([value]).to(estimate) for value in (noise.floor, noise.dof or 1.0))
        return cls(estimate, floor, dof, inflation=noise.inflation, exact=True, transfer=transfer)

    @property
    def lags(self) -> int:
        """Number of lags used: one of each pair."""
        return int(self.used.sum())

    def __call__(self, albedo: torch.Tensor) -> torch.Tensor:
        """Return the log-likelihood of albedos (n, 64, 64) minus that of a perfect fit, (n,); differentiable."""
        return self.at(albedo).log_likelihood()

    def at(self, albedo: torch.Tensor, weight: torch.Tensor | None = None) -> LikelihoodPoint:
        """Evaluate the likelihood at albedos (n, 64, 64).

        Args:
            weight: weight of each lag in the fit of the gains, (n, 64, 128). By default 1 for every lag that is used, 0 for others.
        """
        return LikelihoodPoint(self, albedo, self.used if weight is None else weight)

    def by_lag(self, expected: torch.Tensor) -> torch.Tensor:
        """Return the contribution of each lag to the log-likelihood of expectations, (n, 64, 128), at most 0."""
        perfect = (self.values.clamp_min(MIN_ESTIMATE) / expected).log()
        return self.used * self.dof * (1.0 - self.values / expected + perfect)

    def misfit(self, albedo: torch.Tensor) -> float:
        """Return the log-likelihood deficit (nats) of an albedo (64, 64) relative to a model with one free mean per lag,
        none of them below the floor, minus its expectation under noise; for one estimate.
        """
        best = float(self.by_lag(self.values.clamp_min(self.floor)).sum())
        dof = float(self.dof) * self.inflation
        above = int((self.used * (self.values > self.floor)).sum())
        by_noise = float(self.dof) * (math.log(dof) - float(digamma(dof))) * above
        return best - by_noise - float(self(albedo[None]))


class LikelihoodPoint:
    """A likelihood at albedos (n, 64, 64), with its derivatives; the gradient is zero at an albedo of zeros."""

    def __init__(self, likelihood: Likelihood, albedo: torch.Tensor, weight: torch.Tensor) -> None:
        estimate, floor, used, pedestal = likelihood.values, likelihood.floor, likelihood.used, likelihood.pedestal
        self._likelihood, self._model, self._albedo = likelihood, likelihood.model, albedo.to(estimate.dtype)
        self._spectrum = self._model.spectrum(self._albedo)
        signal = self._model.signal((self._spectrum * self._spectrum.conj()).real)
        scale = (signal.detach() * used).amax((-2, -1)).clamp_min(1e-6)[:, None, None]
        signal = signal / scale
        flat = (one.flatten(1) for one in (signal, pedestal, estimate, floor, weight))
        bright, faint = (gain[:, None, None] for gain in fit_gains(*flat, likelihood.rounds))
        expected = floor + bright * signal + faint * pedestal
        self._expected = expected
        self._gain, self._excess = bright / scale, estimate - expected
        self._weight = used * likelihood.dof * self._gain / expected.square()

    @property
    def gain(self) -> torch.Tensor:
        """Fitted gain a of r*r of each albedo, (n,), over the maximum lag of the estimate."""
        return self._gain[:, 0, 0]

    @cached_property
    def by_lag(self) -> torch.Tensor:
        """Contribution of each lag to the log-likelihood, (n, 64, 128); differentiable."""
        return self._likelihood.by_lag(self._expected)

    def log_likelihood(self) -> torch.Tensor:
        """Return the log-likelihood of the albedos minus that of a perfect fit, (n,), in nats."""
        return self.by_lag.sum((-2, -1))

    def deviance(self) -> torch.Tensor:
        """Return the reduced deviance per lag, (n,): 1 at the truth, more if signal is unexplained."""
        return -2.0 * self.log_likelihood() / self._likelihood.lags

    def gradient(self) -> torch.Tensor:
        """Return the gradient of the log-likelihood, (n, 64, 64)."""
        return self._model.slope(self._weight * self._excess, self._spectrum)

    def information(self) -> torch.Tensor:
        """Return the Fisher information of each pixel, (n, 64, 64), at fixed gains; accurate to a factor of two, because
        the correlation of opposite lags is neglected."""
        return self._model.slope(self._weight * self._gain, self._model.spectrum(self._albedo.square())).clamp_min(1e-6)

    def curvature(self, change: torch.Tensor) -> torch.Tensor:
        """Return the Fisher information along a change of the albedo (n, 64, 64), (n,): minus the expected second derivative of
        the log-likelihood, at fixed gains.
        """
        of_signal = self._model.signal(2.0 * (self._spectrum.conj() * self._model.spectrum(change)).real)
        return (self._weight * self._gain * of_signal.square()).sum((-2, -1))


def log_likelihood_leads(reference: np.ndarray, albedo: np.ndarray, captures: Sequence[Measurement]) -> list[float]:
    """Return the lead in log-likelihood (nats) of `albedo` over `reference`, for each of several captures of the object.

    The captures must not be those of the reconstructions; then neither albedo has been fitted to their noise.
    """
    both = torch.from_numpy(np.stack((albedo, reference)))
    likelihoods = [Likelihood.of(capture)(both) for capture in captures]
    return [float(ours - theirs) for ours, theirs in likelihoods]
