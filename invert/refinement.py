"""Likelihood ascent: a reconstruction follows the data as far as lags that it has not seen confirm it.

Where noise is low a network's picture stops short of what the data hold; where it is high, whatever likelihood gains is noise.
So two copies climb, each the likelihood of one half of the lags, and are judged by the other half; the step at which both
together were judged best is how far the reconstruction itself then climbs the likelihood of all lags.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import torch

from invert.likelihood import NoiseLikelihood
from invert.spectrum import Measurement

STEPS = 120
PATIENCE = 12
"""Steps without improvement after which the ascent stops."""

SURE = 2.0
"""Standard errors by which the judgement must have risen."""

STEP = 0.01
"""Of the root of the albedo, whose largest value is 1; Adam's."""

LEAST = 1e-4
"""Albedo that a dark pixel starts from: at zero, the root has no slope."""


def refined(albedo: torch.Tensor, measurement: Measurement) -> torch.Tensor:
    """A reconstruction (64, 64), largest value 1, after the ascent; itself where no step is confirmed."""
    likelihood = NoiseLikelihood(measurement, albedo.device, torch.float32)
    half = (torch.rand(likelihood.lags, generator=torch.Generator().manual_seed(0)) < 0.5).float().to(albedo.device)
    steps = _confirmed_steps(albedo, likelihood, torch.stack((half, 1.0 - half)))
    if steps == 0:
        return albedo
    image = next(islice(_climb(albedo[None], likelihood, torch.ones_like(half)), steps, None))[0]
    return image / image.amax().clamp_min(1e-30)


@torch.no_grad()
def _confirmed_steps(albedo: torch.Tensor, likelihood: NoiseLikelihood, halves: torch.Tensor) -> int:
    """Steps after which two copies that climb one half (2, lags) each gain most in the other; 0 where that may be chance."""
    judged = []
    best, most = 0, 0.0
    for step, copies in enumerate(islice(_climb(albedo.expand(2, -1, -1), likelihood, halves), STEPS)):
        judged.append(((1.0 - halves) * likelihood.by_lag(copies, halves)).sum(0))
        gain = float((judged[-1] - judged[0]).sum())
        if gain > most:
            best, most = step, gain
        if step - best > PATIENCE:
            break
    error = float((judged[best] - judged[0]).std()) * (likelihood.lags * likelihood.inflation) ** 0.5
    return best if most > SURE * error else 0


def _climb(albedo: torch.Tensor, likelihood: NoiseLikelihood, weight: torch.Tensor) -> Iterator[torch.Tensor]:
    """Albedos (n, 64, 64) before each step, without end."""
    root = (albedo.clamp_min(0.0) + LEAST).sqrt().requires_grad_()
    adam = torch.optim.Adam([root], lr=STEP)
    while True:
        with torch.enable_grad():
            image = root.square()
            loss = -(weight * likelihood.by_lag(image, weight)).sum()
        yield image.detach()
        adam.zero_grad()
        loss.backward()
        adam.step()
