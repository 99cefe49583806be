"""Likelihood ascent of a reconstruction, stopped early by two-fold cross-validation over the lags.

Where noise is low a network's picture stops short of what the data hold; where it is high, whatever the likelihood gains is
noise. So two copies ascend, each on one half of the lags, and are scored on the other half; the number of steps at which their
held-out log-likelihood is largest is then taken on all lags.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import torch

from invert.likelihood.gamma import NoiseLikelihood
from invert.measure.spectrum import Measurement

MAX_STEPS = 120
PATIENCE = 12
"""Steps without improvement after which the ascent stops."""

MIN_GAIN_SIGMA = 2.0
"""Standard errors by which the held-out log-likelihood must have risen."""

LEARNING_RATE = 0.01
"""Of the root of the albedo, whose largest value is 1; Adam's."""

MIN_ALBEDO = 1e-4
"""Albedo that a dark pixel starts from: at zero, the root has no slope."""


def refine_by_likelihood(albedo: torch.Tensor, measurement: Measurement) -> torch.Tensor:
    """A reconstruction (64, 64), largest value 1, after the ascent; itself where the held-out gain may be chance."""
    likelihood = NoiseLikelihood(measurement, albedo.device, torch.float32)
    half = (torch.rand(likelihood.lags, generator=torch.Generator().manual_seed(0)) < 0.5).float().to(albedo.device)
    steps = _validated_steps(albedo, likelihood, torch.stack((half, 1.0 - half)))
    if steps == 0:
        return albedo
    image = next(islice(_ascent(albedo[None], likelihood, torch.ones_like(half)), steps, None))[0]
    return image / image.amax().clamp_min(1e-30)


@torch.no_grad()
def _validated_steps(albedo: torch.Tensor, likelihood: NoiseLikelihood, halves: torch.Tensor) -> int:
    """Number of steps of largest held-out log-likelihood, of copies that see one half (2, lags) each; 0 if it may be chance."""
    held_out = []
    best, most = 0, 0.0
    for step, copies in enumerate(islice(_ascent(albedo.expand(2, -1, -1), likelihood, halves), MAX_STEPS)):
        held_out.append(((1.0 - halves) * likelihood.by_lag(copies, halves)).sum(0))
        gain = float((held_out[-1] - held_out[0]).sum())
        if gain > most:
            best, most = step, gain
        if step - best > PATIENCE:
            break
    error = float((held_out[best] - held_out[0]).std()) * (likelihood.lags * likelihood.inflation) ** 0.5
    return best if most > MIN_GAIN_SIGMA * error else 0


def _ascent(albedo: torch.Tensor, likelihood: NoiseLikelihood, weight: torch.Tensor) -> Iterator[torch.Tensor]:
    """Albedos (n, 64, 64) before each step, without end."""
    root = (albedo.clamp_min(0.0) + MIN_ALBEDO).sqrt().requires_grad_()
    adam = torch.optim.Adam([root], lr=LEARNING_RATE)
    while True:
        with torch.enable_grad():
            image = root.square()
            loss = -(weight * likelihood.by_lag(image, weight)).sum()
        yield image.detach()
        adam.zero_grad()
        loss.backward()
        adam.step()
