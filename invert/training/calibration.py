"""`python -m invert.calibrate WEIGHTS TARGETS.zarr`: calibrate the `confidence` of a network and its credible intervals of sizes.

The targets are held out from training; their estimates have noise of every kind. The correlation that each quality reaches is
fitted by a logistic function of features known without the truth (`network/confidence.py`). The error of the sizes, in units of
the deviation of the samples, is recorded (`invert/albedo/posterior.py`). Both are stored in the metadata of the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import expit

from correlograph.command import ArgumentParser
from correlograph.ranges import SEED, Range
from invert.albedo.posterior import SIZES, SizeStatistics, measure_size
from invert.choices import BALANCED, BEST, FAST, Quality
from invert.network.confidence import confidence
from invert.training.data import Batch, make_varied_batch

RIDGE = 1e-2
"""Weight of the squared coefficients, which keeps correlated features finite."""

QUANTILES = 41
"""Number of equidistant quantiles of the error of a size."""


@dataclass(frozen=True)
class Observed:
    """Confidence features (n, 4) of n reconstructions, their correlations with the truth (n,), and errors of sizes in
    units of the deviation of the samples."""

    features: np.ndarray
    achieved: np.ndarray
    errors: dict[str, list[float]]


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m invert.calibrate", description="Calibrate the confidence of a network.")
    p.add_argument("weights", type=Path, help="weights of the network, .safetensors; the calibration is added to this file")
    p.add_argument("targets", help="dataset made by python -m data_gen")
    p.add_argument("--count", type=Range(20, 100_000), default=200, help="number of targets to reconstruct (200)")
    p.add_argument("--seed", type=SEED, default=0)
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    options = parser().parse_args(argv)
    from correlograph.files.manifest import claim
    from data_gen.dataset import load_targets
    from invert.network.checkpoints import read_weights, save_weights

    _, held_out = load_targets(options.targets)
    batch = make_varied_batch(held_out, options.count, torch.Generator().manual_seed(options.seed))
    tensors, card = read_weights(options.weights)
    claim(options.weights.parent, [options.weights.name], overwrite=options.overwrite)
    card["calibration"] = {}
    for quality in (FAST, BALANCED):
        observed = _observe(batch, options.weights, quality)
        coefficients = fit_logistic(observed.features, observed.achieved)
        error = np.abs(confidence(coefficients, observed.features) - observed.achieved).mean()
        card["calibration"][quality.name] = coefficients
        print(
            f"{quality}: mean difference of confidence and achieved correlation {error:.3f} "
            f"on {len(observed.achieved)} estimates"
        )
        if all(observed.errors.values()):
            card["calibration"]["sizes"] = {size: conformal_quantiles(errors) for size, errors in observed.errors.items()}
    # The calibration of `balanced` serves `best`: more starts, samples and rounds change little.
    card["calibration"][BEST.name] = card["calibration"][BALANCED.name]
    save_weights(options.weights, tensors, card)


def _observe(batch: Batch, weights: Path, quality: Quality) -> Observed:
    """Reconstruct all estimates of a batch that show an object, as `python -m invert` does, and compare with the truths."""
    from tqdm import tqdm

    from invert.measure.estimate import Estimate
    from invert.pipeline import reconstruct
    from invert.training.losses import registered_pearson

    features, achieved = [], []
    errors: dict[str, list[float]] = {size: [] for size in SIZES}
    for lags, truth in zip(tqdm(batch.seen.values, desc=quality.name, disable=None), batch.truth, strict=True):
        found = reconstruct(Estimate("target", lags.numpy()), quality=quality, weights=weights).reconstruction
        if found.features is None:
            continue
        albedo = torch.from_numpy(found.albedo if found.rejected is None else found.rejected)
        pearson = float(registered_pearson(albedo[None], truth[None])[0]) if truth.any() else 0.0
        features.append(found.features)
        achieved.append(max(pearson, 0.0))
        if found.posterior is not None and truth.any():
            for size, own in errors.items():
                own.append(SizeStatistics.of(found.posterior.samples, size).error(measure_size(truth.numpy(), size)))
    return Observed(np.array(features), np.array(achieved), errors)


def conformal_quantiles(errors: Sequence[float]) -> list[float]:
    """Return equidistant quantiles of n errors for intervals that hold the error of a new case as often as stated.

    The new case is one of n + 1 (conformal prediction, V. Vovk, A. Gammerman, G. Shafer, Algorithmic Learning in a Random World, 2005): the
    quantile at p is the error of rank p (n + 1).
    """
    return np.quantile(errors, np.linspace(0.0, 1.0, QUANTILES), method="weibull").tolist()


def fit_logistic(features: np.ndarray, achieved: np.ndarray) -> list[float]:
    """Fit a logistic function of features (n, m) to `achieved` (n,) in cross-entropy; return its coefficients, offset first.

    A small ridge term keeps constant features harmless.
    """
    basis = np.column_stack([np.ones(len(features)), features])

    def cross_entropy(weight: np.ndarray) -> tuple[float, np.ndarray]:
        logit = basis @ weight
        value = np.logaddexp(0.0, logit).sum() - achieved @ logit + 0.5 * RIDGE * (weight @ weight)
        return value, basis.T @ (expit(logit) - achieved) + RIDGE * weight

    return minimize(cross_entropy, np.zeros(basis.shape[1]), jac=True, method="BFGS").x.tolist()
