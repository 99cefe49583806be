"""`python -m invert.calibrate WEIGHTS TARGETS.zarr`: calibrate a network's `confidence`.

On targets held out from training, at noise of every kind, the correlation that each quality achieves is fitted by a
logistic function of what is known without the truth (`network/confidence.py`). The coefficients go into the weights' card.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import expit

from invert.network.confidence import confidence
from radiometry.errors import ArgumentParser
from radiometry.ranges import SEED, Range

RIDGE = 1e-2


def main(argv: Sequence[str] | None = None) -> None:
    parser = ArgumentParser(prog="python -m invert.calibrate", description="Calibrate the confidence of a network.")
    parser.add_argument("weights", type=Path)
    parser.add_argument("targets", help="dataset made by python -m data_gen")
    parser.add_argument("--count", type=Range(20, 100_000), default=200)
    parser.add_argument("--seed", type=SEED, default=0)
    options = parser.parse_args(argv)
    from data_gen.dataset import load_targets
    from invert.network.checkpoints import read_weights, save_weights
    from invert.training.data import varied

    _, held_out = load_targets(options.targets)
    batch = varied(held_out, options.count, torch.Generator().manual_seed(options.seed))
    tensors, card = read_weights(options.weights)
    card["calibration"] = {}
    for quality in ("fast", "balanced"):
        features, achieved = _observe(batch, options.weights, quality)
        coefficients = fit_logistic(features, achieved)
        error = np.abs(confidence(coefficients, features) - achieved).mean()
        card["calibration"][quality] = coefficients
        print(f"{quality}: mean difference of confidence and achieved correlation {error:.3f} on {len(achieved)} estimates")
    card["calibration"]["best"] = card["calibration"]["balanced"]  # the same augmentations; more starts change little
    save_weights(options.weights, tensors, card)


def _observe(batch, weights: Path, quality: str) -> tuple[np.ndarray, np.ndarray]:
    """Confidence features (n, 4) of each reconstruction, and the correlation that it achieves, (n,)."""
    from tqdm import tqdm

    from invert.methods import finished
    from invert.network.checkpoints import load_network
    from invert.network.inference import reconstruct_by_network
    from invert.spectrum import read_measurement
    from invert.training.losses import registered_pearson

    network, _ = load_network(weights)
    features, achieved = [], []
    for estimate, truth in zip(tqdm(batch.seen.estimate, desc=quality, disable=None), batch.truth, strict=True):
        measurement = read_measurement(estimate.numpy())
        if not measurement.detectable:
            continue
        answer = reconstruct_by_network(network, measurement, quality, 0, "cpu")
        albedo = finished(answer.image, measurement, quality)
        found = float(registered_pearson(albedo[None], truth[None])[0]) if truth.any() else 0.0
        features.append(answer.features)
        achieved.append(max(found, 0.0))
    return np.array(features), np.array(achieved)


def fit_logistic(features: np.ndarray, achieved: np.ndarray) -> list[float]:
    """Coefficients (offset first) of the logistic function of features (n, m) nearest to `achieved` (n,) in cross-entropy.

    A small ridge term keeps constant features harmless.
    """
    basis = np.column_stack([np.ones(len(features)), features])

    def cross_entropy(weight: np.ndarray) -> tuple[float, np.ndarray]:
        logit = basis @ weight
        value = np.logaddexp(0.0, logit).sum() - achieved @ logit + 0.5 * RIDGE * (weight @ weight)
        return value, basis.T @ (expit(logit) - achieved) + RIDGE * weight

    return minimize(cross_entropy, np.zeros(basis.shape[1]), jac=True, method="BFGS").x.tolist()
