"""What classical retrieval proposes to the network: pictures of each start, and which of the drawings made of them to keep."""

from __future__ import annotations

import torch

from invert.projections import Candidates
from invert.registration import agreeing_mean, centred, consensus, registered
from invert.spectrum import Measurement
from radiometry.noise_level import INDEPENDENT, RING
from radiometry.noise_model import window_smoothed

COMPANIONS = 8
"""Starts, of least residual, with which every start is compared."""

LEAST_FLOOR = 1e-3
"""Over the largest lag that is used: no drawing explains its estimate better than to so much."""

_USED = torch.from_numpy((RING > 1) & INDEPENDENT)
"""Lags next to zero lag say little of a shape."""


def overview(found: Candidates) -> tuple[torch.Tensor, list[float]]:
    """Pictures (PICTURES, 64, 64) of all starts together, and how far they agree.

    Of the retrieval from the estimate and of that from its denoised signal (`found` holds both) the mean of the best starts,
    which is smooth where they differ, and the start of least residual, which is sharp; laid over the first.
    """
    pictures, agreement = [], []
    for images, residual in zip(found.images, found.residual, strict=True):
        together = consensus(images, residual)
        pictures += [together.image, images[residual.argmin()]]
        agreement.append(together.agreement)
    laid_over, _ = registered(torch.stack(pictures), pictures[0])
    return _in_window(laid_over), agreement


def proposals(found: Candidates) -> torch.Tensor:
    """The same for every start, (n, PICTURES, 64, 64): the mean of it and of the best starts that agree with it, it alone, and
    of the best starts of the other retrieval the mean of those that fit it nearly as well as any, and that which fits best."""
    best = found.residual.argsort(dim=1, stable=True)[:, :COMPANIONS]
    proposed = []
    for own, images in enumerate(found.images):
        others = found.images[1 - own, best[1 - own]]
        for index, start in enumerate(images):
            siblings, likeness = registered(torch.cat((start[None], images[best[own][best[own] != index]])), start)
            cousins, fit = registered(others, start)
            here = [agreeing_mean(siblings, likeness), start]
            there = [agreeing_mean(cousins, fit), cousins[fit.argmax()]]
            proposed.append(_in_window(torch.stack(here + there if own == 0 else there + here)))
    return torch.stack(proposed)


def log_likelihoods(albedo: torch.Tensor, measurement: Measurement) -> torch.Tensor:
    """Log-likelihood of a measurement if its object looked like each albedo (n, 64, 64), but for a constant; (n,).

    The noise model's: Gamma of shape K with mean S = a H (r*r) + b, with b and K as they were read; the brightness a of each is
    the likeliest one (weighted least squares, weights 1 / S^2, repeated).
    """
    used = _USED.to(albedo.device)
    estimate = torch.from_numpy(measurement.estimate).to(albedo.device).double()[used]
    height = estimate.abs().amax().clamp_min(1e-300)
    estimate, floor = estimate / height, max(measurement.noise.floor / float(height), LEAST_FLOOR)
    signal = window_smoothed(albedo.double())[:, used]
    signal = signal / signal.amax(1, keepdim=True).clamp_min(1e-300)
    expected = torch.full_like(signal, floor)
    for _ in range(8):
        weighted = signal / expected.square()
        brightness = (weighted * (estimate - floor)).sum(1) / (weighted * signal).sum(1).clamp_min(1e-300)
        expected = floor + brightness.clamp_min(0.0)[:, None] * signal
    return -(measurement.noise.dof or 1.0) * (expected.log() + estimate / expected).sum(1)


def _in_window(pictures: torch.Tensor) -> torch.Tensor:
    """The middle of pictures (n, 128, 128), taken together, largest value 1 each; zero or more."""
    window = centred(pictures.clamp_min(0.0))
    return window / window.amax((-2, -1), keepdim=True).clamp_min(1e-30)
