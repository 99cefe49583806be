"""`python -m benchmarks.exchangeability PHOTOGRAPHS`: whether the truth could be one of the posterior samples.

If samples come from the posterior, any statistic of the truth has a uniformly distributed rank among those of the samples (simulation-based
calibration, Talts et al. 2018, doi:10.48550/arXiv.1804.06788). The table has one row per family of objects, at every noise level of
`invert.evaluate`, and four statistics:

rank       log-likelihood of the estimate, mean rank of the truth and the largest difference of the ranks from a uniform distribution
norm       square root of the summed squares, at the gain that fits the estimate
TARP       distance from a reference, the truth of another case, at unit norm and the best shift and twin image
           (Lemos et al. 2023, doi:10.48550/arXiv.2302.03026)
spread     distance of two samples over that of a sample from the truth, at unit norm; 1 is right

The column `chance` holds the difference that chance exceeds in 5 % of the tables. `--figure` draws the expected coverage: the fraction of
truths whose rank is below each probability, which is that probability if the samples are right. Only the sampler runs, on all objects at
a time, without the candidates, the centring between rounds and the early end of `invert`.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from scipy.stats import kstest, kstwo

from data_gen.shapes import strokes
from invert.albedo.registration import normalise_peak
from invert.choices import BALANCED, DEFAULT_WEIGHTS
from invert.evaluation.sets import NOISE_LEVELS, edges, grey, shapes, unusual
from invert.network.annealing import INITIAL_SCHEDULE, Annealing, Chain, draw_last_round, run_annealing
from invert.network.checkpoints import load_network
from invert.network.data_steps import replace_unlikely_samples
from invert.network.features import Observation
from invert.training.data import at_noise

BATCH_IMAGES = 8192
"""Images that are sampled at a time."""


@dataclass(frozen=True)
class Ranks:
    """Ranks of the truth among the samples, 0 to 1, and spread of the samples, of each of n objects."""

    likelihood: np.ndarray
    norm: np.ndarray
    tarp: np.ndarray
    spread: np.ndarray

    @classmethod
    def join(cls, parts: list[Ranks]) -> Ranks:
        return cls(*(np.concatenate(values) for values in zip(*(vars(one).values() for one in parts), strict=True)))


SETS = {
    "characters": lambda _, count, seed: shapes(count, seed),
    "grey": grey,
    "edges": edges,
    "unusual": lambda _, count, seed: unusual(count, seed),
}
"""Test sets of `invert.evaluate`, as functions of photographs, count and seed; some have fewer objects than asked for."""


def truths_of(family: str, photographs: Path, count: int, seed: int) -> torch.Tensor:
    """Return `count` objects of a family, (count, 64, 64)."""
    if family == "strokes":
        rng = np.random.default_rng(seed)
        return torch.from_numpy(np.stack([strokes(rng) / np.float32(255.0) for _ in range(count)]))
    found: list[np.ndarray] = []
    while len(found) < count:
        found += [case.truth for case in next(SETS[family](photographs, count - len(found), seed)).cases]
        seed += 1
    return torch.from_numpy(np.stack(found)).float()


def sample(sampler: torch.nn.Module, seen: Observation, samples: int, rng: torch.Generator) -> torch.Tensor:
    """Return samples (n, samples, 64, 64) of n objects: the rounds of `balanced`, then as many last rounds as needed."""
    options = Annealing.of(BALANCED)
    count = options.samples

    def repeated(times: int) -> Chain:
        return Chain(sampler, _repeat(seen, times), 1.0, rng)

    chain = repeated(count)
    state, _ = run_annealing(
        chain, torch.zeros(len(seen) * count, 64, 64, device=rng.device), replace(options, **INITIAL_SCHEDULE)
    )
    for _ in range(options.rounds):
        grouped = state.unflatten(0, (-1, count))
        likely = [
            replace_unlikely_samples(seen.part(slice(n, n + 1), rng.device), one, one[:0]) for n, one in enumerate(grouped)
        ]
        state, _ = run_annealing(chain, torch.cat(likely), options)
    starts = state.unflatten(0, (-1, count))[:, torch.arange(samples, device=rng.device) % count].flatten(0, 1)
    return normalise_peak(draw_last_round(repeated(samples), starts, options)).unflatten(0, (-1, samples))


def _repeat(seen: Observation, times: int) -> Observation:
    return Observation(*(value.repeat_interleave(times, 0) for value in vars(seen).values()))


def rank(values: torch.Tensor) -> np.ndarray:
    """Return the fraction of samples below the truth, which is the first of each row (n, 1 + samples); ties count half."""
    truth, others = values[:, :1], values[:, 1:]
    return ((others < truth).double().mean(1) + 0.5 * (others == truth).double().mean(1)).cpu().numpy()


def distance(one: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Return distances (n, m) of images (n, 64, 64) from others (n, m, 64, 64) of unit norm, at the best shift and twin image."""
    side = 2 * one.shape[-1]
    spectrum, spectra = torch.fft.rfft2(one, s=(side, side))[:, None], torch.fft.rfft2(others, s=(side, side))
    likeness = [torch.fft.irfft2(spectrum * turned, s=(side, side)).amax((-2, -1)) for turned in (spectra, spectra.conj())]
    return (2.0 - 2.0 * torch.maximum(*likeness)).clamp_min(0.0).sqrt()


def measure(seen: Observation, truth: torch.Tensor, reference: torch.Tensor, samples: torch.Tensor) -> Ranks:
    """Compare the samples (n, m, 64, 64) of n objects with their truths."""
    together = torch.cat((normalise_peak(truth)[:, None], samples), 1)
    points = [seen.part(slice(n, n + 1), truth.device).likelihood().at(one) for n, one in enumerate(together)]
    log_likelihood = torch.stack([one.log_likelihood() for one in points])
    norm = together.square().sum((-2, -1)).sqrt()
    unit, gain = together / norm[..., None, None], torch.stack([one.gain for one in points])
    away = reference / reference.square().sum((-2, -1)).sqrt()[:, None, None]
    from_truth, in_pairs = distance(unit[:, 0], unit[:, 1:]), distance(unit[:, 1], unit[:, 2:])
    spread = (in_pairs.mean(1) / from_truth.mean(1)).cpu().numpy()
    return Ranks(rank(log_likelihood), rank(gain.sqrt() * norm), rank(distance(away, unit)), spread)


def main() -> None:
    """Print the table, a family as soon as it is measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", type=Path, help="folder of photographs that training did not see, such as BSDS500/val")
    parser.add_argument("--families", nargs="+", choices=("strokes", *SETS), default=["strokes", *SETS])
    parser.add_argument("--count", type=int, default=16, help="objects of each family, a multiple of the eight noise levels")
    parser.add_argument("--samples", type=int, default=24)
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--figure", type=Path, help="file for the expected coverage")
    options = parser.parse_args()
    sampler = load_network(DEFAULT_WEIGHTS, options.device)[0].sampler
    print("| family | estimates | rank: mean, difference | norm | TARP | chance | spread |\n|---|---|---|---|---|---|---|")
    found = {}
    for family in options.families:
        found[family] = of_family(sampler, truths_of(family, options.photographs, options.count, options.seed), options)
        print(line(family, found[family]), flush=True)
    if options.figure is not None:
        draw_coverage(found).savefig(options.figure, dpi=110)


def of_family(sampler: torch.nn.Module, truths: torch.Tensor, options: argparse.Namespace) -> Ranks:
    """Return the ranks of objects (n, 64, 64), at the noise levels in turn."""
    levels = [NOISE_LEVELS[number % len(NOISE_LEVELS)] for number in range(len(truths))]
    floor, dof = (torch.tensor(values) for values in zip(*levels, strict=True))
    rng = torch.Generator(options.device).manual_seed(options.seed)
    whole = at_noise(truths, floor / 255.0, dof, torch.Generator().manual_seed(options.seed)).seen
    each, parts = max(2, BATCH_IMAGES // options.samples), []
    for begin in range(0, len(truths), each):
        seen, truth = whole.part(slice(begin, begin + each), options.device), truths[begin : begin + each].to(options.device)
        reference = truths.roll(len(NOISE_LEVELS), 0)[begin : begin + each].to(options.device)
        parts.append(measure(seen, truth, reference, sample(sampler, seen, options.samples, rng)))
    return Ranks.join(parts)


def line(family: str, ranks: Ranks) -> str:
    """Return the row of the table of one family."""
    differences = [kstest(values, "uniform").statistic for values in (ranks.likelihood, ranks.norm, ranks.tarp)]
    count = len(ranks.likelihood)
    return (
        f"| {family} | {count} | {ranks.likelihood.mean():.2f}, {differences[0]:.2f} | {differences[1]:.2f} | {differences[2]:.2f} "
        f"| {kstwo.isf(0.05, count):.2f} | {np.median(ranks.spread):.2f} |"
    )


def draw_coverage(found: dict[str, Ranks]) -> Figure:
    """Return the distribution of the ranks of each family, with the band that holds the whole curve of exchangeable samples in 95 % of the
    cases."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    probability = np.linspace(0.0, 1.0, 201)
    for axes, (name, title) in zip(
        figure.subplots(1, 3, sharey=True),
        (("likelihood", "log-likelihood"), ("norm", "norm"), ("tarp", "distance from a reference (TARP)")),
        strict=True,
    ):
        for family, ranks in found.items():
            values = np.sort(getattr(ranks, name))
            axes.plot(probability, np.searchsorted(values, probability, "right") / len(values), label=family)
        band = kstwo.isf(0.05, min(len(ranks.likelihood) for ranks in found.values()))
        axes.fill_between(probability, probability - band, probability + band, color="0.88")
        axes.set(title=title, xlabel="rank of the truth", xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    figure.axes[0].set_ylabel("fraction of truths below")
    figure.axes[0].legend(fontsize=8, frameon=False)
    return figure


if __name__ == "__main__":
    main()
