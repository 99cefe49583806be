"""`python -m invert.calibrate WEIGHTS TARGETS.zarr`: make a network's `confidence` mean what it says.

On targets held out from training, at noise of every kind, the correlation that each quality achieves is fitted by a
logistic function of what is known without the truth: the network's own expectation, how far its drawings agree, how far
the classical starts do. The coefficients go into the weights' card.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from radiometry.errors import ArgumentParser, InputError, check_seed, run_command


def main(argv: Sequence[str] | None = None) -> None:
    parser = ArgumentParser(prog="python -m invert.calibrate", description="Calibrate the confidence of a network.")
    parser.add_argument("weights", type=Path)
    parser.add_argument("targets", help="dataset made by python -m data_gen")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    check_seed(options.seed)
    if options.count < 20:
        raise InputError("--count", "20 or more", options.count, "choose another")
    from data_gen.dataset import load_targets
    from invert.training_data import varied
    from invert.weights import read_weights, save_weights

    _, held_out = load_targets(options.targets)
    batch = varied(held_out, options.count, torch.Generator().manual_seed(options.seed))
    tensors, card = read_weights(options.weights)
    card["calibration"] = {}
    for quality in ("fast", "balanced"):
        signs, achieved = _observe(batch, options.weights, quality)
        fit = fit_logistic(signs, achieved)
        error = np.abs(confidence(fit, signs) - achieved).mean()
        card["calibration"][quality] = fit
        print(f"{quality}: mean difference of confidence and achieved correlation {error:.3f} on {len(achieved)} estimates")
    card["calibration"]["best"] = card["calibration"]["balanced"]  # the same looks; more starts change little
    save_weights(options.weights, tensors, card)


def _observe(batch, weights: Path, quality: str) -> tuple[np.ndarray, np.ndarray]:
    """Signs (n, 4) of how good each reconstruction is, and how good it is, (n,)."""
    from tqdm import tqdm

    from invert.learned import draw
    from invert.losses import registered_pearson
    from invert.registration import centred
    from invert.spectrum import read_measurement
    from invert.weights import load_network

    network, _ = load_network(weights)
    signs, achieved = [], []
    for estimate, truth in zip(tqdm(batch.seen.estimate, desc=quality, disable=None), batch.truth, strict=True):
        measurement = read_measurement(estimate.numpy())
        if not measurement.detectable:
            continue
        drawing = draw(network, measurement, quality, 0, "cpu")
        found = float(registered_pearson(centred(drawing.image)[None], truth[None])[0]) if truth.any() else 0.0
        signs.append(drawing.signs)
        achieved.append(max(found, 0.0))
    return np.array(signs), np.array(achieved)


def fit_logistic(signs: np.ndarray, achieved: np.ndarray, steps: int = 50) -> list[float]:
    """Coefficients (offset first) of the logistic function of signs (n, m) nearest to `achieved` (n,) in cross-entropy.

    Newton's method with a little ridge, so that signs that never vary do no harm.
    """
    basis = np.column_stack([np.ones(len(signs)), signs])
    weight = np.zeros(basis.shape[1])
    for _ in range(steps):
        predicted = 1.0 / (1.0 + np.exp(-basis @ weight))
        slope = basis.T @ (predicted - achieved) + 1e-2 * weight
        curvature = (basis * (predicted * (1.0 - predicted))[:, None]).T @ basis + 1e-2 * np.eye(len(weight))
        weight -= np.linalg.solve(curvature, slope)
    return [float(value) for value in weight]


def confidence(fit: Sequence[float], signs: np.ndarray) -> np.ndarray:
    """Expected correlation, 0 to 1, from signs (..., m)."""
    return 1.0 / (1.0 + np.exp(-(fit[0] + np.asarray(signs) @ np.asarray(fit[1:]))))


if __name__ == "__main__":
    run_command(main)
