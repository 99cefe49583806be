"""`python -m benchmarks.field_starts`: how much of a field the search from a random field misses.

Fields are drawn from the prior, so that model and prior are right and only the phase has to be found. Each frame is retrieved from two
random fields and from the true one, which no repair of phase vortices can surpass. The table has one row per number of photons per
grain of the bounding box, with means over the frames:

gain       log-likelihood of the held-out counts minus that of the Wiener filter, in nats per pixel: from a random field; from that of
           two random fields which explains the fitted counts better; with the mean of both predictions; from the true field
coherence  median over the wall of the local coherence, in windows of five grains: of the results of both random fields; of one of them and
           of the result of the true field with the truth
image      correlation of the mean |E|^2, smoothed by a lag, with |E|^2 of the truth: from a random field, from both, from the true one
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
import torch
from scipy import ndimage
from torch.nn.functional import avg_pool2d

from data_gen.shapes import strokes
from invert.field.certificate import predict_held_out
from invert.field.counts import HELD_OUT_FRACTION, FrameCounts
from invert.field.filtering import filter_counts, intensity_spectrum
from invert.field.forward_model import ForwardModel, expected_counts, log_likelihood, power
from invert.field.frame_retrieval import SAMPLES_FRACTION, WARM_UP_FRACTION, search_steps
from invert.field.grid import FieldGrid, field_grid
from invert.field.posterior import FieldPosterior
from invert.field.prior import prior_from_albedo, scale_to_signal
from invert.field.sampling import PosteriorMean, Sampling
from invert.field.search import Search
from radiometry.field_forecast import bounding_box

PHOTONS_PER_GRAIN = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)

FRAME, PATCH = (400, 452), (128, 128)
"""Pixels of a frame and of the patch of one lag per pixel."""

WINDOW_GRAINS = 5.0


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=8, help="objects, with one frame each, per number of photons")
    frames = parser.parse_args(argv).frames
    print(
        "| photons per grain | gain: one, better, both, truth | coherence: two, with truth, from truth | image: one, both, truth |"
    )
    print("|---|---|---|---|")
    for photons in PHOTONS_PER_GRAIN:
        rows = np.array([compare_starts(photons, seed) for seed in range(frames)])
        mean = [f"{one:.3f}" for one in rows.mean(0)]
        print(f"| {photons:g} | {' '.join(mean[:4])} | {' '.join(mean[4:7])} | {' '.join(mean[7:])} |", flush=True)


def compare_starts(photons: float, seed: int) -> list[float]:
    """Return the ten figures of one frame with a number of photons per grain."""
    rng = torch.Generator().manual_seed(seed)
    albedo = strokes(np.random.default_rng(seed))
    grid = field_grid(FRAME, PATCH, bounding_box(albedo))
    model = ForwardModel(grid, torch.ones(grid.shape[0], grid.shape[1] // 2 + 1))
    signal = photons / grid.pixels_per_grain
    prior = scale_to_signal(prior_from_albedo(albedo, grid), signal, grid)
    truth = torch.complex(*torch.randn(2, 1, *prior.shape, generator=rng)) * (0.5 * prior).sqrt()
    counts = draw_counts(model, truth, signal, rng)
    spectrum = intensity_spectrum(prior, model)
    target = filter_counts(counts, spectrum, model)
    filtered = expected_counts(grid.on_frame(model.blur(target)), counts)
    search, posterior, steps = Search(model, counts, target, prior), FieldPosterior(model, counts, prior), search_steps(photons)

    def sample(start: torch.Tensor) -> PosteriorMean:
        return Sampling(posterior, rng).run(start, round(WARM_UP_FRACTION * steps), round(SAMPLES_FRACTION * steps))

    def gain(expected: torch.Tensor) -> float:
        found = predict_held_out(counts, expected, filtered)
        return found.gain_nats / found.pixels

    def fit(found: PosteriorMean) -> float:
        return float(log_likelihood(counts.values[counts.fitted], found.expected[counts.fitted], counts.roughness).sum())

    def image(strength: torch.Tensor) -> float:
        widths = [1.0 / width for width in grid.cell_lags]
        smooth = [ndimage.gaussian_filter(part[0].numpy(), widths).ravel() for part in (strength, power(truth))]
        return float(np.corrcoef(smooth[0], smooth[1])[0, 1])

    one, other = (sample(search.run(search.random_field(rng), steps)) for _ in range(2))
    best = sample(truth)
    better = max(one, other, key=fit)
    gains = [gain(part) for part in (one.expected, better.expected, 0.5 * (one.expected + other.expected), best.expected)]
    pairs = ((one.field, other.field), (one.field, truth), (best.field, truth))
    images = [image(part) for part in (one.power, 0.5 * (one.power + other.power), best.power)]
    return [*gains, *(local_coherence(grid, *pair) for pair in pairs), *images]


def draw_counts(model: ForwardModel, truth: torch.Tensor, signal: float, rng: torch.Generator) -> FrameCounts:
    """Return the counts of a frame of a field, without background."""
    expected = model.intensity(model.grid.to_wall(truth)).clamp_min(0.0)
    held_out = torch.rand(expected.shape, generator=rng) < HELD_OUT_FRACTION
    values = torch.poisson(expected, generator=rng)
    return FrameCounts(values, values, ~held_out, held_out, torch.ones(()), 0.0, signal)


def local_coherence(grid: FieldGrid, one: torch.Tensor, other: torch.Tensor) -> float:
    """Return the median over the wall of |sum U V*| / sqrt(sum |U|^2 sum |V|^2), sums over windows of `WINDOW_GRAINS`."""
    first, second = (grid.on_frame(grid.to_wall(part)) for part in (one, other))
    side = round(WINDOW_GRAINS * grid.pixels_per_grain**0.5)
    product = avg_pool2d(torch.view_as_real(first * second.conj()).movedim(-1, 0).flatten(0, 1), side).square().sum(0)
    powers = avg_pool2d(power(first), side) * avg_pool2d(power(second), side)
    return float((product / powers[0]).sqrt().median())


if __name__ == "__main__":
    main()
