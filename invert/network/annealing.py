"""Posterior sampling: annealed diffusion with data-consistency steps.

Each sample starts as pure noise. The sampler network denoises it in steps, and data-consistency steps follow each of them. Then
rounds add noise again and denoise again. With an exact network and no further steps, a round leaves the posterior unchanged (it
is Gibbs sampling of an object and its noisy image), so rounds correct local errors and keep what the added noise does not hide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import torch

from correlograph.lags import lag_grid_of
from correlograph.progress import Progress, no_progress
from invert.albedo.registration import crop_centred, normalise_peak, register_images, zero_pad
from invert.choices import Quality
from invert.likelihood.data_consistency import MAX_ALBEDO, run_data_consistency_steps
from invert.network.features import Observation, fill_zero_lag_by_neighbours, mean_near_zero_lag
from invert.network.sampler import Sampler, posterior_variance


@dataclass(frozen=True)
class Annealing:
    """Schedule of the sampling.

    Attributes:
        samples: number of samples.
        rounds: maximum number of re-noising rounds.
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

REPLACEMENT_MARGIN_NATS, MAX_REPLACED_FRACTION = 60.0, 1 / 3
"""Minimum lead in log-likelihood of a replacement over its sample, and maximum fraction of samples replaced. The limit of one
third keeps the samples diverse: without it, bright captures leave copies of one sample."""

CANDIDATE_SIGMA = 0.2
"""Noise level at which candidates take data-consistency steps before they compete with samples."""

MAX_FINAL_STEPS = 50
"""Maximum number of final data-consistency steps. They stop at a reduced deviance of 1 (Morozov's discrepancy principle)."""

FRESH_NOISE_FRACTION = 0.5
"""Fraction of the noise that is sampled independently at each step."""

PRIOR_VARIANCE_FACTOR = 10.0
"""Prior variance around the denoiser output, in units of `posterior_variance`. Evidence: docs/research.md."""

NOISE_GAIN_NATS_PER_PIXEL = 0.1
"""Log-likelihood that data-consistency steps gain from noise alone, per pixel that the data determine and per unit of
`floor_fraction`. Evidence: docs/research.md."""


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


def sample_posterior(chain: Chain, candidates: torch.Tensor, options: Annealing) -> AnnealingResult:
    """Sample the posterior of one object. The rounds end early when the mean of the denoiser outputs has converged.

    Args:
        candidates: albedos (m, 64, 64) that replace unlikely samples before the first round.
    """
    observation, data = chain.observation, chain.data
    denoised_means: list[torch.Tensor] = []
    sigma = observation.dof.new_full((len(candidates),), CANDIDATE_SIGMA)
    candidates = apply_shrunken_data_step(data, candidates, sigma, options.ascent)
    side = lag_grid_of(observation.values).object_side
    zeros = torch.zeros(options.samples, side, side, device=observation.values.device)
    first = replace(options, **INITIAL_SCHEDULE)
    samples, _ = run_annealing(chain, zeros, first)
    mean = zero_pad(samples[0])
    for number in range(options.rounds):
        others = candidates[:0] if number else candidates
        samples = torch.stack([crop_centred(one) for one in zero_pad(replace_unlikely_samples(data, samples, others))])
        samples, denoised = run_annealing(chain, samples, options)
        denoised_means.append(denoised)
        registered, _ = register_images(zero_pad(normalise_peak(denoised)), mean)
        former, mean = mean, registered.sum(0) + (mean if number else 0.0)
        if number and float(register_images(mean[None], former)[1]) >= options.converged:
            chain.progress((options.rounds - number - 1) * options.steps)
            break
    variance = PRIOR_VARIANCE_FACTOR * posterior_variance(torch.full_like(observation.dof, options.last))
    samples = run_data_consistency_steps(
        data.likelihood(), normalise_peak(samples), variance, MAX_FINAL_STEPS, 1.0 / chain.inflation
    )
    return AnnealingResult(normalise_peak(samples), torch.cat(denoised_means))


@torch.no_grad()
def run_annealing(chain: Chain, starts: torch.Tensor, options: Annealing) -> tuple[torch.Tensor, torch.Tensor]:
    """Add noise to albedos (n, 64, 64) and denoise them; return the albedos and the mean of the denoiser outputs."""
    levels = options.levels().to(starts)
    albedo, noisy = starts, starts + levels[0] * chain.noise(starts)
    total = torch.zeros_like(starts)
    for level, following in zip(levels, [*levels[1:], None], strict=True):
        sigma = level.expand(len(starts))
        denoised = chain.sampler(chain.observation, noisy, sigma, albedo).clamp(0.0, MAX_ALBEDO)
        total += denoised
        albedo = apply_shrunken_data_step(chain.data, denoised, sigma, options.ascent)
        if following is not None:
            noisy = renoise(albedo, noisy, level, following, chain.noise(starts))
        chain.progress()
    return albedo, total / options.steps


def apply_shrunken_data_step(data: Observation, denoised: torch.Tensor, sigma: torch.Tensor, steps: int) -> torch.Tensor:
    """Apply data-consistency steps to denoiser outputs (n, 64, 64), shortened by the expected gain from noise alone.

    Positive-part Stein shrinkage: steps that gain no more than noise would are undone, others in part
    (B. Efron, C. Morris, J. Am. Stat. Assoc. 68, 117, 1973, doi:10.1080/01621459.1973.10481350).
    """
    variance = PRIOR_VARIANCE_FACTOR * posterior_variance(sigma)
    likelihood = data.likelihood()
    moved = run_data_consistency_steps(likelihood, denoised, variance, steps)
    before, change = likelihood.at(denoised), moved - denoised
    gain = likelihood.at(moved).log_likelihood() - before.log_likelihood()
    information = before.information()
    determined = (information / (information + variance.reciprocal()[:, None, None]) * (change != 0.0)).sum((-2, -1))
    noise_gain = NOISE_GAIN_NATS_PER_PIXEL * floor_fraction(data) * determined
    kept = (1.0 - noise_gain / gain.clamp_min(1e-6)).clamp_min(0.0)
    return denoised + kept[:, None, None] * change


def floor_fraction(data: Observation) -> torch.Tensor:
    """Return the fraction of the noise floor in the lags next to zero lag, (n,), 0 to 1."""
    near = mean_near_zero_lag(fill_zero_lag_by_neighbours(data.values))
    return (data.floor / near.clamp_min(1e-30)).clamp(0.0, 1.0)


def renoise(
    albedo: torch.Tensor, noisy: torch.Tensor, level: torch.Tensor, following: torch.Tensor, noise: torch.Tensor
) -> torch.Tensor:
    """Add noise of the following level to albedos: partly the rescaled present noise of `noisy`, partly new noise."""
    kept = (1.0 - FRESH_NOISE_FRACTION**2) ** 0.5 * following / level
    return albedo + kept * (noisy - albedo) + FRESH_NOISE_FRACTION * following * noise


def replace_unlikely_samples(data: Observation, samples: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Replace the least likely samples (n, 64, 64) by the most likely of all samples and others (m, 64, 64).

    Later rounds would correct them as well. However, an object that is mostly right converges faster than one that is not.
    """
    pool = torch.cat((samples, others))
    likelihood = data.likelihood()(pool)
    best = likelihood.argsort(descending=True, stable=True)
    worst = likelihood[: len(samples)].argsort(stable=True)[: int(MAX_REPLACED_FRACTION * len(samples))]
    best = best[: len(worst)]
    source = torch.arange(len(samples), device=samples.device)
    source[worst] = torch.where(likelihood[worst] < likelihood[best] - REPLACEMENT_MARGIN_NATS, best, worst)
    return pool[source]
