"""Which object an estimate speaks for: its likelihood under drawings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from invert.spectrum import Measurement
from radiometry.autocorrelation import LAGS
from radiometry.noise_level import INDEPENDENT, RING
from radiometry.noise_model import window_smoothed

PEDESTAL_LAGS = 32.0
"""Standard deviation of the pedestal that an estimate may have, half the window. The lab's have one, 2 to 4 % of the brightest
lag whatever the object; taken for part of it, it favours smeared drawings."""

LEAST_FLOOR = 1e-3
"""Over the largest lag that is used: no drawing explains its estimate better than to so much."""

_USED = torch.from_numpy((RING > 1) & INDEPENDENT)
"""Lags next to zero lag say little of a shape."""

_PROFILE = torch.exp(-0.5 * (torch.arange(-LAGS, LAGS + 1).double() / PEDESTAL_LAGS).square())
_PEDESTAL = torch.outer(_PROFILE, _PROFILE)[_USED]


def log_likelihoods(albedo: torch.Tensor, measurement: Measurement) -> torch.Tensor:
    """Log-likelihood of a measurement if its object looked like each albedo (n, 64, 64), but for a constant; (n,).

    The noise model's: Gamma of shape K with mean S = a H (r*r) + c p + b, with b and K as they were read and p a wide pedestal;
    a and c, zero or more, are the likeliest for each (weighted least squares, weights 1 / S^2, repeated).
    """
    used, pedestal = _USED.to(albedo.device), _PEDESTAL.to(albedo.device)
    estimate = torch.from_numpy(measurement.estimate).to(albedo.device).double()[used]
    height = estimate.abs().amax().clamp_min(1e-300)
    estimate, floor = estimate / height, max(measurement.noise.floor / float(height), LEAST_FLOOR)
    signal = window_smoothed(albedo.double())[:, used]
    signal = signal / signal.amax(1, keepdim=True).clamp_min(1e-300)
    expected = torch.full_like(signal, floor)
    for _ in range(8):
        bright, faint = _brightnesses(signal, pedestal, estimate - floor, expected.square().reciprocal())
        expected = floor + bright[:, None] * signal + faint[:, None] * pedestal
    return -(measurement.noise.dof or 1.0) * (expected.log() + estimate / expected).sum(1)


def nats_over(reference: np.ndarray, albedo: np.ndarray, captures: Sequence[Measurement]) -> float:
    """How much likelier captures of an object are, in nats each, if it looks like `albedo` than like `reference`.

    Where neither was made of these captures, this favours none of them for its noise.
    """
    both = torch.from_numpy(np.stack((albedo, reference)))
    likelihoods = torch.stack([log_likelihoods(both, capture) for capture in captures])
    return float((likelihoods[:, 0] - likelihoods[:, 1]).mean())


def _brightnesses(signal: torch.Tensor, pedestal: torch.Tensor, excess: torch.Tensor,
                  weight: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Weighted least squares: a and c (n,), zero or more, that bring a signal (n, lags) + c pedestal nearest to an excess."""
    signals, pedestals = (weight * signal.square()).sum(1).clamp_min(1e-300), (weight * pedestal.square()).sum(1)
    share = (weight * signal * pedestal).sum(1) / signals
    found, wide = (weight * excess * signal).sum(1) / signals, (weight * excess * pedestal).sum(1)
    unshared = (pedestals - share.square() * signals).clamp_min(1e-12 * pedestals)
    # At the most what the pedestal explains without a signal, where the best signal would be negative.
    faint = torch.minimum((wide - share * signals * found) / unshared, wide / pedestals).clamp_min(0.0)
    return (found - share * faint).clamp_min(0.0), faint
