"""`python -m benchmarks.more_lags PHOTOGRAPHS [--count 64] [--seed 701]`: confidence on 96 and 128 lags, for which it is not calibrated.

Objects of the sixteen unusual kinds, and edges of photographs, with noise from the noise model. The table holds the mean
correlation with the truth, and the confidence minus this correlation: mean, mean of the moduli, and largest.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from skimage.transform import resize
from tqdm import tqdm

import correlograph as cg
from data_gen.edges import Photographs, edge_targets, find_photographs, read_luminance
from invert.evaluation.sets import NOISE_LEVELS, UNUSUAL_LEVELS
from invert.evaluation.unusual import KINDS
from invert.measure.estimate import Estimate
from invert.training.data import at_noise
from invert.training.losses import registered_pearson

SIDES = (96, 128)


def draw_unusual(side: int, rng: np.random.Generator) -> np.ndarray:
    """Return an object of a random kind, (side, side)."""
    return resize(np.asarray(KINDS[rng.integers(len(KINDS))](rng), np.float64), (side, side), order=1, anti_aliasing=True)


def draw_edges(files: Photographs, side: int, rng: np.random.Generator) -> np.ndarray:
    """Return the edges of a random photograph, (side, side)."""
    found = None
    while found is None:
        found = edge_targets(read_luminance(files.folder / str(rng.choice(files.names))), 1, rng, side)
    return found[0].astype(np.float64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photographs", type=Path)
    parser.add_argument("--count", type=int, default=64, help="number of objects of each kind and number of lags")
    parser.add_argument("--seed", type=int, default=701)
    parser.add_argument("--quality", default="balanced")
    options = parser.parse_args()
    files = find_photographs(options.photographs)
    print("| objects | lags | number | correlation | difference | modulus | largest |\n|---|---|---|---|---|---|---|")
    for family, levels in (("unusual", UNUSUAL_LEVELS), ("edges", NOISE_LEVELS)):
        for side in SIDES:
            found = []
            for number in tqdm(range(options.count), desc=f"{family}, {side}", disable=None, leave=False):
                rng = np.random.default_rng([options.seed, number, side])
                drawn = draw_unusual(side, rng) if family == "unusual" else draw_edges(files, side, rng)
                truth = torch.from_numpy((drawn / drawn.max()).astype(np.float32))[None]
                floor, dof = levels[number % len(levels)]
                noise = torch.Generator().manual_seed(1000 * options.seed + number)
                estimate = Estimate(family, at_noise(truth, floor / 255.0, dof, noise).seen.values[0].numpy())
                result = cg.reconstruct(estimate, quality=options.quality)
                if result.object_found:
                    found.append(
                        (float(registered_pearson(torch.from_numpy(result.albedo)[None], truth)[0]), result.confidence)
                    )
            achieved, confidence = np.array(found).T
            apart = confidence - achieved
            numbers = (achieved.mean(), apart.mean(), np.abs(apart).mean(), apart.max())
            print(f"| {family} | {side} | {len(found)} | " + " | ".join(f"{one:.3f}" for one in numbers) + " |", flush=True)


if __name__ == "__main__":
    main()
