"""`python -m benchmarks.stem_place [--count 16] [--floors 2 4] [--rendered] [--measured PNG...]`: localise a letter stem in noise.

The object resembles the 7 of the lab, with noise floors from a quarter to four times the signal's largest value at a nonzero
lag. The table compares the reconstruction with an ideal observer, who knows bar and stem and chooses among five positions.
It shows how well the estimate separates the object from the bar alone, and the two closest positions (divergence in nats),
how often observer and reconstruction find the right position, the fraction of samples at the right position, and the
calibration error of these fractions. Estimates are sampled from the noise model (K 64) or, with --rendered, from two
rendered frames of the reference scene. With files of the lab's 7, the observer evaluates these.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import brentq
from tqdm import tqdm

from invert.albedo.registration import on_grid, register_images
from invert.likelihood.gamma import Likelihood
from invert.measure.estimate import Estimate, estimate_from_frames, published_estimate
from invert.measure.spectrum import Measurement, read_measurement
from invert.pipeline import reconstruct
from radiometry.noise.measured_noise import NoiseLevel
from radiometry.noise.model import autocorrelate_windowed, draw_estimate

DOF = 64.0
FLOORS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""The lab's are 0.23, 0.46, 0.84 and 2.0 at 1/4, 1/8, 1/16 and 1/32 s."""

COLUMNS = (32, 24, 16, 8, 0)
"""Places of the stem along the bar, the right one first. A stem above the bar is the twin image of one below it."""


def bar_and_stem(column: int | None) -> torch.Tensor:
    """Return a bar of 38 x 2 pixels with slope 1:8 and, unless `column` is None, a stem of 7 x 4 pixels below it; (64, 64)."""
    image = torch.zeros(64, 64)
    for place in range(38):
        image[35 - place // 8 : 37 - place // 8, 13 + place] = 1.0
    if column is not None:
        top = 37 - column // 8
        image[top : top + 7, 13 + column : 17 + column] = 1.0
    return image


CANDIDATES = torch.stack([bar_and_stem(column) for column in (*COLUMNS, None)])
"""The object, the stem in its other places, the bar alone; (6, 64, 64)."""


def signal() -> torch.Tensor:
    """H (r*r) of the object, scaled so that its largest value, zero lag excluded, is 1."""
    lags = autocorrelate_windowed(CANDIDATES[0].double())
    return lags / lags[63, 64]


def divergences(floor: float) -> tuple[float, float]:
    """Mean log-likelihood ratios of the object to the bar alone, and to the object with its stem at the nearest other
    position.
    """
    expected = Measurement((floor + signal()).float().numpy(), NoiseLevel(floor, DOF, 40), 1.0, 0.0, 100.0, ())
    nats = Likelihood.of(expected)(CANDIDATES)
    return float(nats[0] - nats[-1]), float(nats[0] - nats[1:-1].max())


def simulate_estimates(floor: float, count: int) -> Iterator[Estimate]:
    """Sample estimates from the noise model."""
    for number in range(count):
        lags = draw_estimate(floor + signal(), DOF, torch.Generator().manual_seed(number))
        yield Estimate(str(number), lags.float().numpy())


def render_estimates(floor: float, count: int) -> Iterator[Estimate]:
    """Render two frames per estimate, exposed so that their noise floor is as given."""
    import sim
    from radiometry.prediction import predict
    from sim.rendering import render_geometry

    geometry = sim.load("corner_letter").geometry
    geometry = geometry.with_object(CANDIDATES[0].numpy(), predict(geometry).pitches_m)
    prediction = predict(geometry)

    def excess(power: float) -> float:
        return (prediction.at_exposure(10.0**power).floor_over_peak(2) or np.inf) / prediction.signal[63, 64] - floor

    exposure_s = 10.0 ** brentq(excess, -6.0, 1.0)
    for seed in range(count):
        yield estimate_from_frames(render_geometry(geometry.with_exposure(exposure_s), 2, seed))


def place_shares(candidates: torch.Tensor, samples: np.ndarray) -> np.ndarray:
    """Share of the samples (n, 64, 64) that are nearest to each candidate on the grid, (candidates,)."""
    nearest = [int(register_images(candidates, on_grid(one))[1].argmax()) for one in samples]
    return np.bincount(nearest, minlength=len(candidates)) / len(nearest)


def calibration_error(shares: np.ndarray) -> float:
    """Return the calibration error of fractions (captures, positions) as probabilities; the first position is the right one."""
    happens = np.zeros_like(shares)
    happens[:, 0] = 1.0
    tenth = np.minimum((10.0 * shares).astype(int), 9)
    apart = [(shares[tenth == one] - happens[tenth == one]).sum() for one in range(10)]
    return float(np.abs(apart).sum() / shares.size)


def _read_measurement(file: Path) -> Measurement:
    estimate = published_estimate(file)
    return read_measurement(estimate.values, estimate.quantisation)


def observe(file: Path) -> str:
    """Return the log-likelihood ratio (nats) of each stem position to the bar alone, for a published autocorrelation, as a
    table row.
    """
    *places, none = Likelihood.of(_read_measurement(file))(CANDIDATES).tolist()
    return f"| {file.stem} | {' | '.join(f'{place - none:.1f}' for place in places)} |"


def main() -> None:
    """Print a table, one row a floor or a file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=16, help="estimates a floor")
    parser.add_argument("--floors", type=float, nargs="+", default=FLOORS)
    parser.add_argument("--quality", choices=("fast", "balanced", "best"), default="balanced")
    parser.add_argument("--rendered", action="store_true", help="estimates from two rendered frames each")
    parser.add_argument("--measured", type=Path, nargs="+", help="published autocorrelations of such an object, instead")
    options = parser.parse_args()
    if options.measured:
        print(f"| nats over the bar alone, stem at | {' | '.join(map(str, COLUMNS))} |\n|---|{'---|' * len(COLUMNS)}")
        print("\n".join(observe(file) for file in options.measured))
        return
    count = options.count
    candidates = torch.stack([on_grid(one.numpy()) for one in CANDIDATES[:-1]])
    print(
        f"| floor | stem, nats | its place, nats | of {count}: found by the observer | drawn | in its place | likeness "
        "| samples in its place | calibration error |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for floor in options.floors:
        observed, likeness, shares = [], [], []
        estimates = (render_estimates if options.rendered else simulate_estimates)(floor, count)
        for number, estimate in enumerate(tqdm(estimates, total=count, desc=f"floor {floor:g}", disable=None)):
            result = reconstruct(estimate, quality=options.quality, seed=number)
            observed.append(int(Likelihood.of(result.measurement)(CANDIDATES[:-1]).argmax()))
            if result.object_found:
                likeness.append(register_images(candidates, on_grid(result.albedo))[1])
            if result.samples is not None:
                shares.append(place_shares(candidates, result.samples.samples))
        fits = torch.stack(likeness) if likeness else torch.empty(0, len(COLUMNS))
        stem, place = divergences(floor)
        placed = int((fits.argmax(1) == 0).sum())
        print(
            f"| {floor:g} | {stem:.0f} | {place:.1f} | {observed.count(0)} | {len(fits)} | {placed} "
            f"| {float(fits[:, 0].mean()):.2f} | {np.mean(shares, 0)[0] if shares else np.nan:.2f} "
            f"| {calibration_error(np.array(shares)) if shares else np.nan:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
