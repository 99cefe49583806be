"""Samples of the posterior: from noise alone, which the sampler removes in steps, each followed by steps towards the data; then
in rounds that hide what was found in noise again.

With the sampler exact and no further steps, a round of it would leave the posterior unchanged (Gibbs sampling of an object
and a noisy picture of it). What is found first is wrong in places; a round keeps what noise does not hide and mends the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from correlograph.lags import OBJECT_SIDE
from invert.albedo.registration import centred, normalised, padded
from invert.network.features import Observation, mean_about_zero_lag, without_zero_lag
from invert.network.fisher_scoring import LARGEST, Likelihood, towards_data
from invert.network.sampler import Sampler, posterior_variance


@dataclass(frozen=True)
class Annealing:
    """How samples are drawn.

    Attributes:
        samples: how many.
        rounds: how often they are hidden in noise again.
        steps: of noise levels in each, from `first` to `last`, evenly in their cube roots.
        ascent: steps towards the data at each.
    """

    samples: int
    rounds: int
    steps: int = 6
    first: float = 0.8
    last: float = 0.05
    ascent: int = 8

    def levels(self) -> torch.Tensor:
        """Noise of each step."""
        return level_at(torch.linspace(0.0, 1.0, self.steps), self.first, self.last)


def level_at(share: torch.Tensor, first: float | torch.Tensor, last: float) -> torch.Tensor:
    """Noise when a share of a round's steps is done, evenly in its cube root."""
    return (first ** (1 / 3) * (1.0 - share) + last ** (1 / 3) * share) ** 3


ANNEALING = {"balanced": Annealing(12, rounds=8), "best": Annealing(32, rounds=12)}

BEGINNING = {"first": 4.0, "steps": 8}
"""Noise that hides any object, and steps of what precedes the rounds."""

MARGIN, REPLACED = 60.0, 1 / 3
"""Nats by which a sample may be less likely than a likelier one before that takes its place; share of the samples of which this
is asked, the least likely. Were it asked of all, bright light would leave copies of one, right or wrong."""

PROPOSED = 0.2
"""Noise at which candidates follow the data before they are compared with samples."""

FINAL_ASCENT = 50
"""Largest number of steps towards the data at the end, until the estimate is explained (Morozov's discrepancy principle)."""

FRESH = 0.5
"""Share of the noise that is drawn anew at each step."""

DATA_WEIGHT = 10.0
"""By how much the variance of what the sampler says exceeds that of a Gaussian; the best of 1, 3, 10 and 30 on edges."""

BY_CHANCE = 0.1
"""Nats that steps towards the data gain from noise alone, for each pixel that the data rather than the prior determine; times
the floor's share of the light. Edges one pixel wide at little floor lose what the data tell of them with more, letters over a
high floor follow the noise with less."""


@dataclass(frozen=True)
class Drawn:
    """What annealing draws.

    Attributes:
        samples: albedos (n, 64, 64), largest value 1 each.
        expected: what the sampler expected on the way to them, the mean over each round, (rounds n, 64, 64). Their mean is the
            posterior's, too, and has less noise than that of as many samples (Rao-Blackwell).
    """

    samples: torch.Tensor
    expected: torch.Tensor


def posterior_samples(sampler: Sampler, seen: Observation, inflation: float, candidates: torch.Tensor, options: Annealing,
                      rng: torch.Generator) -> Drawn:
    """Samples of the posterior of one observation.

    Args:
        inflation: by which K counts less in sums over its lags.
        candidates: albedos (m, 64, 64) that take the places of worse samples before the first round.
    """
    seen = _repeated(seen, options.samples)
    data, expected = replace(seen, dof=seen.dof / inflation), []
    candidates = after_data(_repeated(data, len(candidates)), candidates, seen.dof.new_full((len(candidates),), PROPOSED),
                            options.ascent)
    nothing = torch.zeros(options.samples, OBJECT_SIDE, OBJECT_SIDE, device=seen.estimate.device)
    drawn, _ = annealed(sampler, seen, data, nothing, replace(options, **BEGINNING), rng)
    for number in range(options.rounds):
        others = candidates[:0] if number else candidates
        drawn = torch.stack([centred(one) for one in padded(resampled(data, drawn, others))])
        drawn, on_the_way = annealed(sampler, seen, data, drawn, options, rng)
        expected.append(on_the_way)
    variance = DATA_WEIGHT * posterior_variance(torch.full_like(seen.dof, options.last))
    samples = towards_data(data, normalised(drawn), variance, FINAL_ASCENT, 1.0 / inflation)
    return Drawn(normalised(samples), torch.cat(expected))


@torch.no_grad()
def annealed(sampler: Sampler, seen: Observation, data: Observation, starts: torch.Tensor, options: Annealing,
             rng: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Albedos (n, 64, 64) from starts (n, 64, 64) in the same places, and the mean of what the sampler expected.

    Args:
        seen: as the sampler is shown it.
        data: the same, K as it counts in sums over lags.
    """
    def noise() -> torch.Tensor:
        return torch.randn(starts.shape, generator=rng, device=rng.device).to(starts)

    levels = options.levels().to(starts)
    albedo, noisy = starts, starts + levels[0] * noise()
    total = torch.zeros_like(starts)
    for level, following in zip(levels, [*levels[1:], None], strict=True):
        sigma = level.expand(len(starts))
        expected = sampler(seen, noisy, sigma, albedo).clamp(0.0, LARGEST)
        total += expected
        albedo = after_data(data, expected, sigma, options.ascent)
        if following is not None:
            noisy = less_noisy(albedo, noisy, level, following, noise())
    return albedo, total / options.steps


def after_data(data: Observation, expected: torch.Tensor, sigma: torch.Tensor, steps: int) -> torch.Tensor:
    """What the sampler expects (n, 64, 64), moved towards the data by as much as the data have more to say than noise would.

    Steps that gain no more than they would by following noise are taken back, and others in part: the shrinkage of C. Stein
    (B. Efron, C. Morris, J. Am. Stat. Assoc. 68, 117, 1973, doi:10.1080/01621459.1973.10481350).
    """
    variance = DATA_WEIGHT * posterior_variance(sigma)
    moved = towards_data(data, expected, variance, steps)
    likelihood = Likelihood(data)
    before, change = likelihood.at(expected), moved - expected
    gain = likelihood.at(moved).log_likelihood() - before.log_likelihood()
    information = before.information()
    free = (information / (information + variance.reciprocal()[:, None, None]) * (change != 0.0)).sum((-2, -1))
    by_chance = BY_CHANCE * floor_share(data) * free
    share = (1.0 - by_chance / gain.clamp_min(1e-6)).clamp_min(0.0)
    return expected + share[:, None, None] * change


def floor_share(data: Observation) -> torch.Tensor:
    """Share of the floor in the lags beside zero lag, (n,): 0 to 1."""
    near = mean_about_zero_lag(without_zero_lag(data.estimate))
    return (data.floor / near.clamp_min(1e-30)).clamp(0.0, 1.0)


def less_noisy(albedo: torch.Tensor, noisy: torch.Tensor, level: torch.Tensor, following: torch.Tensor,
               noise: torch.Tensor) -> torch.Tensor:
    """Albedos behind noise of the following level, part of it that of the level before, part of it drawn anew."""
    kept = (1.0 - FRESH**2) ** 0.5 * following / level
    return albedo + kept * (noisy - albedo) + FRESH * following * noise


def resampled(data: Observation, drawn: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Albedos (n, 64, 64), of which the worst have made way for the likeliest of these and of others (m, 64, 64).

    Rounds would mend them, too, but later: an object of which much is right is mended faster than one of which little is.
    """
    pool = torch.cat((drawn, others))
    likelihood = Likelihood(_repeated(data, len(pool))).at(pool).log_likelihood()
    best = likelihood.argsort(descending=True, stable=True)
    worst = likelihood[: len(drawn)].argsort(stable=True)[: int(REPLACED * len(drawn))]
    best = best[: len(worst)]
    which = torch.arange(len(drawn), device=drawn.device)
    which[worst] = torch.where(likelihood[worst] < likelihood[best] - MARGIN, best, worst)
    return pool[which]


def _repeated(seen: Observation, count: int) -> Observation:
    """One observation, or the first of several alike, for each of many albedos."""
    return Observation(*(one[:1].expand(count, *one.shape[1:]) for one in vars(seen).values()))
