"""Denoising task of the sampler: albedos with white noise of every level and a self-conditioning input as during sampling."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch

from invert.likelihood.data_consistency import MAX_ALBEDO, run_data_consistency_steps
from invert.network.features import Observation
from invert.network.sampler import ALBEDO_STD, Sampler, posterior_variance

MEDIAN_SIGMA, MIN_SIGMA, MAX_SIGMA = 0.3, 0.02, 4.0
"""Noise levels: log-normal with median `MEDIAN_SIGMA` and a standard deviation of one, within limits."""

PASSES = 2
"""Maximum number of sampler steps at higher noise that produce a self-conditioning input."""

MAX_LOG_SIGMA_RATIO = 1.5
"""Maximum logarithm of the ratio of the noise level of these steps to the training level."""

ASCENT, ASCENT_SHARE = 3, 0.7
"""Number of data-consistency steps after a self-conditioning step, and the probability of them."""

PRIOR_VARIANCE_FACTOR = 3.0
"""Factor of the prior variance in these data-consistency steps; `invert.network.annealing` defines that of the sampling."""

MAX_SHIFT_LAGS = 6
"""Maximum shift of an object from the centre of its window, in lags."""


@dataclass(frozen=True)
class Draws:
    """Random numbers of n samples: levels (n,), noise (1 + PASSES, n, 64, 64), noise ratios of earlier steps (PASSES, n).

    Attributes:
        ascends: whether data-consistency steps follow each earlier step of the batch.
    """

    sigma: torch.Tensor
    noise: torch.Tensor
    ratio: torch.Tensor
    ascends: tuple[bool, ...]

    @classmethod
    def of(cls, count: int, side: int, rng: torch.Generator) -> Draws:
        sigma = (math.log(MEDIAN_SIGMA) + torch.randn(count, generator=rng)).exp().clamp(MIN_SIGMA, MAX_SIGMA)
        passes = int(torch.randint(PASSES + 1, (), generator=rng))
        ascends = torch.rand(passes, generator=rng) < ASCENT_SHARE
        left = torch.arange(PASSES, 0, -1)[:, None] / PASSES
        ratio = (MAX_LOG_SIGMA_RATIO * left * torch.rand(PASSES, count, generator=rng)).exp()
        return cls(sigma, torch.randn(1 + PASSES, count, side, side, generator=rng), ratio, tuple(ascends.tolist()))

    def part(self, which: slice, device: str | torch.device) -> Draws:
        """Return the random numbers of some of the samples, on a device."""
        noise, ratio = (one[:, which].to(device) for one in (self.noise, self.ratio))
        return Draws(self.sigma[which].to(device), noise, ratio, self.ascends)


def shift_randomly(albedo: torch.Tensor, rng: torch.Generator) -> torch.Tensor:
    """Shift each albedo (n, 64, 64) by up to `MAX_SHIFT_LAGS` lags, as far as its window permits."""
    shifted = []
    for one in albedo:
        for axis in (0, 1):
            lit = one.amax(1 - axis).nonzero()
            if len(lit):
                least, most = max(-int(lit[0]), -MAX_SHIFT_LAGS), min(len(one) - 1 - int(lit[-1]), MAX_SHIFT_LAGS)
                one = one.roll(int(torch.randint(least, most + 1, (), generator=rng)), axis)
        shifted.append(one)
    return torch.stack(shifted)


def scale_dof_for_sums(seen: Observation) -> Observation:
    """Return observations with the degrees of freedom K that sums over lags have: a value between those for independent and
    for correlated lags.
    """
    return replace(seen, dof=seen.dof / 2.0)


@torch.no_grad()
def run_self_conditioning(sampler: Sampler, seen: Observation, truth: torch.Tensor, draws: Draws) -> torch.Tensor:
    """Run the sampler on noisier images, step by step, and return its estimate; zeros without earlier steps."""
    guess = torch.zeros_like(truth)
    data = scale_dof_for_sums(seen)
    for ratio, noise, ascends in zip(draws.ratio, draws.noise[1:], draws.ascends, strict=False):
        sigma = (draws.sigma * ratio).clamp_max(MAX_SIGMA)
        guess = sampler(seen, truth + sigma[:, None, None] * noise, sigma, guess).clamp(0.0, MAX_ALBEDO)
        if ascends:
            variance = PRIOR_VARIANCE_FACTOR * posterior_variance(sigma)
            guess = run_data_consistency_steps(data.likelihood(), guess, variance, ASCENT)
    return guess


@dataclass(frozen=True)
class Task:
    """Inputs of the sampler for n objects, and the true albedos; see `Sampler.forward`."""

    seen: Observation
    truth: torch.Tensor
    noisy: torch.Tensor
    sigma: torch.Tensor
    guess: torch.Tensor

    def answer(self, sampler: Sampler) -> torch.Tensor:
        return sampler(self.seen, self.noisy, self.sigma, self.guess)

    def join(self, other: Task) -> Task:
        """Return this task followed by another."""
        seen = Observation(*(torch.cat(both) for both in zip(vars(self.seen).values(), vars(other.seen).values(), strict=True)))
        names = ("truth", "noisy", "sigma", "guess")
        return Task(seen, *(torch.cat((getattr(self, name), getattr(other, name))) for name in names))


def make_denoising_task(sampler: Sampler, seen: Observation, truth: torch.Tensor, draws: Draws) -> Task:
    """Add noise to true albedos; return the noisy albedos as input of the sampler, and the true ones as its target."""
    noisy = truth + draws.sigma[:, None, None] * draws.noise[0]
    return Task(seen, truth, noisy, draws.sigma, run_self_conditioning(sampler, seen, truth, draws))


def denoising_loss(answer: torch.Tensor, truth: torch.Tensor, sigma: torch.Tensor) -> torch.Tensor:
    """Return the squared error of each image, (n,), divided by that of a sampler that always answers the mean target of its
    noise level: 1 if nothing was learned, 0 for a perfect answer."""
    return (answer - truth).square().mean((-2, -1)) * (sigma.square() + ALBEDO_STD**2) / (sigma * ALBEDO_STD).square()
