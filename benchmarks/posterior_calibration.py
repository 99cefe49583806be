"""`python -m benchmarks.posterior_calibration PHOTOGRAPHS`: how often the truth is where samples of the posterior say.

Three families of objects, none of which is in the training targets of the shipped weights: edges of photographs, characters,
grey pieces of photographs; at every noise level of `invert.evaluate`. The table has one row per family: how often the
credible intervals of width, height and area hold the truth, and the largest difference, over five bins that hold a hundredth
of the pixels or more, between the probability that a pixel is bright and how often it is.
`benchmarks.exchangeability` compares the samples with the truth as images.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

import invert
from invert.albedo.posterior import BRIGHT_THRESHOLD, SIZES, Samples, measure_size
from invert.albedo.registration import register_groups
from invert.evaluation.sets import NOISE_LEVELS, Case, edges, grey, shapes

PROBABILITIES = (0.5, 0.8, 0.95)
BINS = np.linspace(0.0, 1.0, 6)


def families(photographs: Path, count: int, seed: int) -> dict[str, list[Case]]:
    """`count` objects of each family at every noise level, no object twice."""
    levels = len(NOISE_LEVELS)
    total = count * levels
    sets = {"edges": edges(photographs, total, seed), "characters": shapes(total, seed), "grey": grey(photographs, total, seed)}
    return {
        name: [case for number, level in enumerate(family) for case in level.cases[number::levels]]
        for name, family in sets.items()
    }


def intervals_hold(samples: Samples, truth: np.ndarray) -> np.ndarray:
    """Whether each interval holds the truth, (sizes, probabilities)."""

    def holds(size: str, probability: float) -> bool:
        low, high = samples.interval(size, probability)
        return low <= measure_size(truth, size) <= high

    return np.array([[holds(size, probability) for probability in PROBABILITIES] for size in SIZES])


def placed_samples(found: invert.Result, truth: np.ndarray) -> np.ndarray:
    """Return the samples (n, 64, 64), registered to the truth by the transformation that registers the albedo."""
    pictures = torch.from_numpy(np.concatenate((found.albedo[None], found.samples.samples)))
    return register_groups(pictures[None], torch.from_numpy(np.ascontiguousarray(truth, np.float32))[None])[0, 1:].numpy()


def unreliability(probability: np.ndarray, shown: np.ndarray) -> float:
    """Return the largest difference, over the probability bins, between mean probability and observed frequency of bright
    pixels.
    """
    bins = np.digitize(probability, BINS[1:-1])
    held = [bins == number for number in range(len(BINS) - 1)]
    differences = [abs(probability[own].mean() - shown[own].mean()) for own in held if own.mean() > 0.01]
    return float(max(differences))


def main() -> None:
    """Print the table, a family as soon as it is measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", type=Path, help="folder of photographs that training did not see, such as BSDS500/val")
    parser.add_argument("--count", type=int, default=6, help="objects of each family at each of eight noise levels")
    parser.add_argument("--quality", choices=("balanced", "best"), default="balanced")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(
        f"| family | estimates | {' | '.join(f'{100 * p:.0f} %' for p in PROBABILITIES)} "
        f"| by size, 80 %: {', '.join(SIZES)} | bright |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, cases in families(options.photographs, options.count, options.seed).items():
        held, likely, shown = [], [], []
        for case in tqdm(cases, desc=name, disable=None, leave=False):
            found = invert.reconstruct(case.estimate, quality=options.quality)
            if found.samples is None:
                continue
            held.append(intervals_hold(found.samples, case.truth))
            placed = placed_samples(found, case.truth)
            likely.append((placed > BRIGHT_THRESHOLD).mean(0).ravel())
            shown.append((case.truth > BRIGHT_THRESHOLD * case.truth.max()).ravel())
        share = np.mean(held, 0)
        print(
            f"| {name} | {len(held)} | {' | '.join(f'{value:.2f}' for value in share.mean(0))} "
            f"| {', '.join(f'{value:.2f}' for value in share[:, 1])} "
            f"| {unreliability(np.concatenate(likely), np.concatenate(shown)):.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
