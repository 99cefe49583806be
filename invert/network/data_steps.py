"""The parts of the sampling that use the likelihood: data steps of the rounds and of the last one, replacement, deviance."""

from __future__ import annotations

from collections.abc import Callable

import torch

from invert.likelihood.data_consistency import Ascent, ascend_to_deviance, run_data_consistency_steps
from invert.network.features import Observation, fill_zero_lag_by_neighbours, mean_near_zero_lag
from invert.network.sampler import ALBEDO_STD, posterior_variance

DataStep = Callable[[Observation, torch.Tensor, torch.Tensor, int], torch.Tensor]
"""Moves denoiser outputs (n, 64, 64) at noise levels (n,) towards the data, in a number of steps."""

PRIOR_VARIANCE_FACTOR = 10.0
"""Prior variance around the denoiser output, in units of `posterior_variance`, in the rounds that search. Evidence:
docs/research.md."""

LAST_VARIANCE_FACTOR = 0.3
"""The same in the last round: the log-likelihood of the truth then has the most uniform rank among those of the samples.
Evidence: docs/research.md."""

NOISE_GAIN_NATS_PER_PIXEL = 0.1
"""Log-likelihood that data-consistency steps gain from noise alone, per pixel that the data determine and per unit of
`floor_fraction`. Evidence: docs/research.md."""

REPLACEMENT_MARGIN_NATS, MAX_REPLACED_FRACTION = 60.0, 1 / 3
"""Minimum lead in log-likelihood of a replacement over its sample, and maximum fraction of samples replaced. The limit of one
third keeps the samples diverse: without it, bright captures leave copies of one sample."""

MAX_FINAL_STEPS = 50
"""Maximum number of data-consistency steps within a prior after the last noise level."""


def take_shrunken_steps(data: Observation, denoised: torch.Tensor, sigma: torch.Tensor, steps: int) -> torch.Tensor:
    """Take data-consistency steps, shortened by the expected gain from noise alone.

    Positive-part Stein shrinkage: steps that gain no more than noise would are undone, others in part
    (B. Efron, C. Morris, J. Am. Stat. Assoc. 68, 117, 1973, doi:10.1080/01621459.1973.10481350).
    """
    variance = PRIOR_VARIANCE_FACTOR * posterior_variance(sigma)
    likelihood = data.likelihood()
    begun = Ascent.begin(likelihood, denoised, variance)
    moved = begun.run(likelihood, steps)
    change = moved - denoised
    gain = likelihood.at(moved).log_likelihood() - begun.at.log_likelihood()
    determined = ((1.0 - begun.precision * begun.preconditioner) * (change != 0.0)).sum((-2, -1))
    noise_gain = NOISE_GAIN_NATS_PER_PIXEL * floor_fraction(data) * determined
    kept = (1.0 - noise_gain / gain.clamp_min(1e-6)).clamp_min(0.0)
    return denoised + kept[:, None, None] * change


def take_last_steps(data: Observation, denoised: torch.Tensor, sigma: torch.Tensor, steps: int) -> torch.Tensor:
    """Take the data-consistency steps of the last round, with a narrow prior."""
    return run_data_consistency_steps(data.likelihood(), denoised, LAST_VARIANCE_FACTOR * posterior_variance(sigma), steps)


def end_at_deviance_of_truth(
    data: Observation, denoised: torch.Tensor, sigma: torch.Tensor, inflation: float, normal: torch.Tensor
) -> torch.Tensor:
    """Move denoiser outputs (n, 64, 64) at noise levels (n,) up their likelihood until each has a deviance that the truth could have.

    A lag of Gamma noise x of shape K has the deviance 2 K (x - 1 - ln x). Its mean is 1 + 1 / (6 K) and its variance 2 + 2 / (3 K), to the
    first order in 1 / K; `inflation` divides K. Stopping at the mean is the discrepancy principle of Morozov; samples that all stopped
    there would be more alike in likelihood than the truth is to them. Albedos that miss their deviance within the prior of other steps
    go on within one as wide as the difference of two objects.

    Args:
        normal: standard normal variates (n,), which choose the deviance of each sample.
    """
    likelihood = data.likelihood()
    per_dof = 1.0 / (inflation * likelihood.dof.flatten())
    deviance = (1.0 + per_dof / 6.0 + ((2.0 + per_dof / 1.5) / likelihood.lags) ** 0.5 * normal) / inflation
    near = PRIOR_VARIANCE_FACTOR * posterior_variance(sigma)
    for variance in (near, torch.full_like(near, 2.0 * ALBEDO_STD**2)):
        denoised = ascend_to_deviance(likelihood, denoised, variance, deviance, MAX_FINAL_STEPS)
    return denoised


def floor_fraction(data: Observation) -> torch.Tensor:
    """Return the fraction of the noise floor in the lags next to zero lag, (n,), 0 to 1."""
    near = mean_near_zero_lag(fill_zero_lag_by_neighbours(data.values))
    return (data.floor / near.clamp_min(1e-30)).clamp(0.0, 1.0)


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
