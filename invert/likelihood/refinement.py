"""Refinement of a reconstruction by likelihood ascent, stopped early by two-fold cross-validation over the lags.

At low noise the image of a network does not use all information in the data; at high noise an ascent would only fit the
noise. Two copies of the image therefore ascend, each on one half of the lags, and are scored on the other half. The number of
steps with the highest held-out log-likelihood is then repeated with all lags.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count, islice

import torch

from invert.likelihood.gamma import Likelihood
from invert.measure.spectrum import Measurement

MAX_STEPS = 120
"""Maximum number of steps of the ascent."""

PATIENCE = 12
"""Steps without improvement after which the ascent stops."""

MIN_GAIN_SIGMA = 2.0
"""Minimum gain of the held-out log-likelihood in standard errors."""

LEARNING_RATE = 0.01
"""Learning rate of Adam for the root of the albedo, whose maximum is 1."""

MEAN_DECAY, SQUARE_DECAY = 0.9, 0.999
"""Decay of Adam's mean slope and mean square slope per step."""

MIN_ALBEDO = 1e-4
"""Initial albedo of dark pixels, because the root has no slope at zero."""


def refine_by_likelihood(albedo: torch.Tensor, measurement: Measurement) -> torch.Tensor:
    """Refine a reconstruction (64, 64), maximum 1, by gradient ascent of its log-likelihood.

    It remains unchanged if the log-likelihood of held-out lags does not rise significantly."""
    likelihood = Likelihood.of(measurement, albedo.device, torch.float32)
    drawn = torch.rand(likelihood.used.shape, generator=torch.Generator().manual_seed(0)).to(albedo.device)
    half = likelihood.used * (drawn < 0.5)
    steps = _validated_steps(albedo, likelihood, torch.cat((half, likelihood.used - half)))
    if steps == 0:
        return albedo
    image = next(islice(_ascent(albedo[None], likelihood, likelihood.used), steps, None))[0]
    return image / image.amax().clamp_min(1e-30)


@torch.no_grad()
def _validated_steps(albedo: torch.Tensor, likelihood: Likelihood, halves: torch.Tensor) -> int:
    """Return the number of steps with the highest held-out log-likelihood; 0 if its gain is not significant.

    Each of two copies ascends on one half of the lags; `halves` are their masks (2, 64, 128)."""
    held_out = []
    best, most = 0, 0.0
    for step, copies in enumerate(islice(_ascent(albedo.expand(2, -1, -1), likelihood, halves), MAX_STEPS)):
        held_out.append((halves.flip(0) * likelihood.at(copies, halves).by_lag).sum(0)[likelihood.used[0] > 0.0])
        gain = float((held_out[-1] - held_out[0]).sum())
        if gain > most:
            best, most = step, gain
        if step - best > PATIENCE:
            break
    error = float((held_out[best] - held_out[0]).std()) * (likelihood.lags * likelihood.inflation) ** 0.5
    return best if most > MIN_GAIN_SIGMA * error else 0


def _ascent(albedo: torch.Tensor, likelihood: Likelihood, weight: torch.Tensor) -> Iterator[torch.Tensor]:
    """Yield albedos (n, 64, 64) before each step, without limit."""
    root = (albedo.clamp_min(0.0) + MIN_ALBEDO).sqrt().requires_grad_()
    mean, square = torch.zeros_like(root), torch.zeros_like(root)
    for step in count(1):
        with torch.enable_grad():
            image = root.square()
            loss = -(weight * likelihood.at(image, weight).by_lag).sum()
        yield image.detach()
        (slope,) = torch.autograd.grad(loss, root)
        # Adam (doi:10.48550/arXiv.1412.6980). The one of torch loads its compiler, which takes 2 s.
        with torch.no_grad():
            mean.lerp_(slope, 1.0 - MEAN_DECAY)
            square.mul_(SQUARE_DECAY).addcmul_(slope, slope, value=1.0 - SQUARE_DECAY)
            deviation = square.sqrt().div_((1.0 - SQUARE_DECAY**step) ** 0.5).add_(1e-8)
            root.addcdiv_(mean, deviation, value=-LEARNING_RATE / (1.0 - MEAN_DECAY**step))
