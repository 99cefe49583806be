"""Posterior sampling: annealed diffusion with data-consistency steps.

Each sample starts as pure noise. The sampler network denoises it in steps, and data-consistency steps follow each of them (`init`).
Then rounds add noise again and denoise again (`step`). With an exact network and no further steps, a round leaves the posterior
unchanged (it is Gibbs sampling of an object and its noisy image), so rounds correct local errors and keep what the added noise
does not hide. These rounds search: their data-consistency steps are long, and fit more noise than the truth does. The last round
(`finish`) takes short ones, so that the truth could be one of its samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import torch

from correlograph.lags import lag_grid_of
from correlograph.progress import Progress, no_progress
from invert.albedo.registration import centre_each, normalise_peak, register_images, zero_pad
from invert.choices import Quality
from invert.likelihood.data_consistency import MAX_ALBEDO
from invert.network.data_steps import (
    DataStep,
    end_at_deviance_of_truth,
    replace_unlikely_samples,
    take_last_steps,
    take_shrunken_steps,
)
from invert.network.features import Observation
from invert.network.sampler import Sampler


@dataclass(frozen=True)
class Annealing:
    """Schedule of the sampling.

    Attributes:
        samples: number of samples.
        rounds: maximum number of re-noising rounds before the last one.
        steps: noise levels per round.
        first, last: highest and lowest noise level of a round; the cube roots of the levels are equidistant.
        ascent: data-consistency steps at each level.
        converged: correlation of the mean denoiser output with that of one round less at which the rounds end.
    """

    samples: int
    rounds: int
    steps: int = 6
    first: float = 0.8
    last: float = 0.05
    ascent: int = 8
    converged: float = 1.0

    @classmethod
    def of(cls, quality: Quality) -> Annealing:
        """Return the schedule of a quality."""
        return cls(quality.samples, quality.rounds, converged=quality.converged)

    def levels(self) -> torch.Tensor:
        """Return the noise level of each step, (steps,)."""
        return noise_level_at(torch.linspace(0.0, 1.0, self.steps), self.first, self.last)


def noise_level_at(fraction: torch.Tensor, first: float | torch.Tensor, last: float) -> torch.Tensor:
    """Return the noise level after a fraction of a round's steps; its cube root falls linearly."""
    return (first ** (1 / 3) * (1.0 - fraction) + last ** (1 / 3) * fraction) ** 3


INITIAL_SCHEDULE = {"first": 4.0, "steps": 8}
"""Initial noise level, which hides any object, and number of steps before the first round."""

CANDIDATE_SIGMA = 0.2
"""Noise level at which candidates take data-consistency steps before they compete with samples."""

FRESH_NOISE_FRACTION = 0.5
"""Fraction of the noise that is sampled independently at each step."""


@dataclass(frozen=True)
class AnnealingResult:
    """Posterior samples.

    Attributes:
        samples: albedos (n, 64, 64), maximum 1 each.
        denoised_means: denoiser outputs averaged over each round, (rounds n, 64, 64). Their mean equals that of the posterior
            and has less noise than the mean of as many samples (Rao-Blackwell).
    """

    samples: torch.Tensor
    denoised_means: torch.Tensor


@dataclass(frozen=True)
class Chain:
    """Network, data and random numbers of the samples of one object.

    Attributes:
        observation: conditioning input of the sampler network, one per albedo or one of all.
        inflation: variance inflation of sums over lags; K is divided by it.
        rng: source of the noise.
        progress: called after each denoising step with a number of steps.
    """

    sampler: Sampler
    observation: Observation
    inflation: float
    rng: torch.Generator
    progress: Progress = no_progress

    @cached_property
    def data(self) -> Observation:
        """The observation with the effective K of sums over lags."""
        return replace(self.observation, dof=self.observation.dof / self.inflation)

    def noise(self, like: torch.Tensor) -> torch.Tensor:
        """Return standard normal noise of the shape of albedos (n, 64, 64)."""
        return torch.randn(like.shape, generator=self.rng, device=self.rng.device).to(like)


@dataclass(frozen=True)
class Sampling:
    """State between rounds.

    Attributes:
        samples: albedos (n, 64, 64).
        candidates: albedos (m, 64, 64) that replace unlikely samples before the next round.
        denoised_means: denoiser outputs averaged over each round so far, (n, 64, 64) each.
        total: their registered sum, (128, 128); before the first round, a sample.
        has_converged: whether the last round hardly changed the direction of `total`.
    """

    samples: torch.Tensor
    candidates: torch.Tensor
    denoised_means: tuple[torch.Tensor, ...]
    total: torch.Tensor
    has_converged: bool = False


def sample_posterior(chain: Chain, candidates: torch.Tensor, options: Annealing) -> AnnealingResult:
    """Sample the posterior of one object. The rounds end early when the mean of the denoiser outputs has converged.

    Args:
        candidates: albedos (m, 64, 64) that replace unlikely samples before the first round.
    """
    state = init(chain, candidates, options)
    while len(state.denoised_means) < options.rounds and not state.has_converged:
        state = step(chain, state, options)
    chain.progress((options.rounds - len(state.denoised_means)) * options.steps)
    return finish(chain, state, options)


def init(chain: Chain, candidates: torch.Tensor, options: Annealing) -> Sampling:
    """Sample from noise alone; move candidates (m, 64, 64) towards the data."""
    side = lag_grid_of(chain.observation.values).object_side
    zeros = torch.zeros(options.samples, side, side, device=chain.observation.values.device)
    samples, _ = run_annealing(chain, zeros, replace(options, **INITIAL_SCHEDULE))
    sigma = chain.observation.dof.new_full((len(candidates),), CANDIDATE_SIGMA)
    candidates = take_shrunken_steps(chain.data, candidates, sigma, options.ascent)
    return Sampling(samples, candidates, (), zero_pad(samples[0]))


def step(chain: Chain, state: Sampling, options: Annealing) -> Sampling:
    """Replace unlikely samples, add noise to all and denoise them: one round."""
    likely = replace_unlikely_samples(chain.data, state.samples, state.candidates)
    samples, denoised = run_annealing(chain, centre_each(likely), options)
    registered, _ = register_images(zero_pad(normalise_peak(denoised)), state.total)
    total = registered.sum(0) + (state.total if state.denoised_means else 0.0)
    has_converged = bool(state.denoised_means) and float(register_images(total[None], state.total)[1]) >= options.converged
    return Sampling(samples, samples[:0], (*state.denoised_means, denoised), total, has_converged)


def finish(chain: Chain, state: Sampling, options: Annealing) -> AnnealingResult:
    """Draw the samples in a last round."""
    samples = draw_last_round(chain, centre_each(state.samples), options)
    return AnnealingResult(normalise_peak(samples), torch.cat(state.denoised_means))


def draw_last_round(chain: Chain, starts: torch.Tensor, options: Annealing) -> torch.Tensor:
    """Run a round with short data-consistency steps; the last ones give each sample (n, 64, 64) a deviance that the truth could have."""
    normal = chain.noise(starts[:, 0, 0])

    def end(data: Observation, denoised: torch.Tensor, sigma: torch.Tensor, _steps: int) -> torch.Tensor:
        return end_at_deviance_of_truth(data, denoised, sigma, chain.inflation, normal)

    return run_annealing(chain, starts, options, take_last_steps, end)[0]


@torch.no_grad()
def run_annealing(
    chain: Chain,
    starts: torch.Tensor,
    options: Annealing,
    data_step: DataStep = take_shrunken_steps,
    last_step: DataStep | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Add noise to albedos (n, 64, 64) and denoise them; return the albedos and the mean of the denoiser outputs.

    Args:
        last_step: takes the place of `data_step` after the last noise level.
    """
    levels = options.levels().to(starts)
    albedo, noisy = starts, starts + levels[0] * chain.noise(starts)
    total = torch.zeros_like(starts)
    for level, following in zip(levels, [*levels[1:], None], strict=True):
        sigma = level.expand(len(starts))
        denoised = chain.sampler(chain.observation, noisy, sigma, albedo).clamp(0.0, MAX_ALBEDO)
        total += denoised
        move = data_step if following is not None else last_step or data_step
        albedo = move(chain.data, denoised, sigma, options.ascent)
        if following is not None:
            noisy = renoise(albedo, noisy, level, following, chain.noise(starts))
        chain.progress()
    return albedo, total / options.steps


def renoise(
    albedo: torch.Tensor, noisy: torch.Tensor, level: torch.Tensor, following: torch.Tensor, noise: torch.Tensor
) -> torch.Tensor:
    """Add noise of the following level to albedos: partly the rescaled present noise of `noisy`, partly new noise."""
    kept = (1.0 - FRESH_NOISE_FRACTION**2) ** 0.5 * following / level
    return albedo + kept * (noisy - albedo) + FRESH_NOISE_FRACTION * following * noise
