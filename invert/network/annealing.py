"""Samples of the posterior: candidates are hidden in noise, which the sampler then removes in steps, each followed by steps
towards the data.

With the sampler exact and no further steps, a round of it would leave the posterior unchanged (Gibbs sampling of an object
and a noisy picture of it); what the candidates got wrong is forgotten as far as the first noise hides it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from invert.network.features import Observation
from invert.network.fisher_scoring import LARGEST, towards_data
from invert.network.sampler import Sampler, posterior_variance
from invert.registration import centred, normalised, padded, registered


@dataclass(frozen=True)
class Annealing:
    """How samples are drawn.

    Attributes:
        samples: how many.
        steps: of noise levels, from `first` to `last`, evenly in their cube roots.
        ascent: steps towards the data at each.
        rounds: how often; each but the first begins with what the last one's samples have in common.
    """

    samples: int
    steps: int = 6
    first: float = 0.8
    last: float = 0.05
    ascent: int = 8
    rounds: int = 3


ANNEALING = {"balanced": Annealing(12), "best": Annealing(32, steps=12)}

POOL = 24
"""Likeliest candidates that are compared with one another."""

ALIKE = 0.8
"""Of the correlation with the most similar other candidate, from which on candidates are taken for the same object."""

FINAL_ASCENT = 50
"""Largest number of steps towards the data at the end, until the estimate is explained (Morozov's discrepancy principle)."""

FRESH = 0.5
"""Share of the noise that is drawn anew at each step."""

DATA_WEIGHT = 10.0
"""By how much the variance of what the sampler says exceeds that of a Gaussian; the best of 1, 3, 10 and 30 on edges."""


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
    """Samples from candidates (m, 64, 64), likeliest first.

    Args:
        seen: the one observation of all.
        inflation: by which K counts less in sums over its lags.
    """
    drawn, expected = candidates[: max(POOL, options.samples)], []
    for _ in range(options.rounds):
        drawn, on_the_way = annealed(sampler, seen, inflation, _in_common(drawn)[: options.samples], options, rng)
        expected.append(on_the_way)
    drawn = normalised(drawn)
    seen = _repeated(seen, len(drawn))
    variance = DATA_WEIGHT * posterior_variance(torch.full_like(seen.dof, options.last))
    data = replace(seen, dof=seen.dof / inflation)
    return Drawn(normalised(towards_data(data, drawn, variance, FINAL_ASCENT, 1.0 / inflation)), torch.cat(expected))


@torch.no_grad()
def annealed(sampler: Sampler, seen: Observation, inflation: float, starts: torch.Tensor, options: Annealing,
             rng: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """One round: albedos (n, 64, 64) from starts (n, 64, 64) in the same places, and the mean of what the sampler expected."""
    count = len(starts)
    seen = _repeated(seen, count)
    data = replace(seen, dof=seen.dof / inflation)

    def noise() -> torch.Tensor:
        return torch.randn(starts.shape, generator=rng, device=rng.device).to(starts)

    levels = torch.linspace(options.first ** (1 / 3), options.last ** (1 / 3), options.steps, device=starts.device) ** 3
    albedo, noisy = starts, starts + levels[0] * noise()
    total = torch.zeros_like(starts)
    for level, following in zip(levels, [*levels[1:], None], strict=True):
        sigma = level.expand(count)
        expected = sampler(seen, noisy, sigma, albedo).clamp(0.0, LARGEST)
        total += expected
        albedo = towards_data(data, expected, DATA_WEIGHT * posterior_variance(sigma), options.ascent)
        if following is not None:
            kept = (1.0 - FRESH**2) ** 0.5 * following / level
            noisy = albedo + kept * (noisy - albedo) + FRESH * following * noise()
    return albedo, total / options.steps


def _repeated(seen: Observation, count: int) -> Observation:
    """One observation, for each of many albedos."""
    return Observation(*(one.expand(count, *one.shape[1:]) for one in vars(seen).values()))


def _in_common(candidates: torch.Tensor) -> torch.Tensor:
    """Of each candidate (n, 64, 64) the mean with all that show the same object, laid over it; largest value 1 each."""
    shown = padded(normalised(candidates))
    means = []
    for number, one in enumerate(shown):
        aligned, likeness = registered(shown, one)
        others = torch.cat((likeness[:number], likeness[number + 1 :]))
        alike = likeness >= ALIKE * (others.max() if len(others) else 0.0)
        means.append(centred(aligned[alike].mean(0).clamp_min(0.0)))
    return normalised(torch.stack(means))
