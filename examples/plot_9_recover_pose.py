"""
Find a pose by gradient descent
===============================

The distance and the rotation of a known letter, from two speckle frames: ``sim.gradients`` differentiates the expected
autocorrelation, and the Gamma likelihood of the estimate is maximised from several starting poses.
"""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
import torch

import sim
from correlograph.lags import LAGS, lag_grid
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
from radiometry.noise.measured_noise import dim_zero_lag
from radiometry.prediction import patches_of
from sim.gradients import Setup, expected_autocorrelation, setup_of

HALF_PLANE = lag_grid(LAGS).half_plane

STARTS = [(distance, tilt) for distance in (0.8, 1.0, 1.3) for tilt in (-0.6, 0.6)]


def recover(estimate: np.ndarray, dof: float, known: Setup, steps: int = 60) -> tuple[float, float, float]:
    """Return the distance in metres and the rotations (right, down) in radians with the highest Gamma likelihood.

    Args:
        estimate: (127, 127) of frames in photoelectrons. known: setup with all other parameters.
    """
    lags = torch.from_numpy(estimate.astype(np.float64))
    seen = torch.from_numpy(HALF_PLANE)

    def misfit(values: torch.Tensor) -> torch.Tensor:
        distance, right, down, floor = values
        # The wall moves with its frame; the spot remains in place.
        expected = expected_autocorrelation(known.with_(detector_m=distance, tilt_right=right, tilt_down=down)) + floor.exp()
        return dof * (expected.log() + lags / expected)[seen].mean()

    best = (math.inf, torch.zeros(4))
    for distance, tilt in STARTS:
        # A small rotation, because the misfit is an even function of it for a letter that faces the wall.
        start = [distance * float(known.detector_m), tilt, 0.05, math.log(float(lags[:20, :20].mean()))]
        values = torch.tensor(start, dtype=torch.float64, requires_grad=True)
        optimiser = torch.optim.LBFGS([values], max_iter=steps, line_search_fn="strong_wolfe")

        def closure(values: torch.Tensor = values, optimiser: torch.optim.LBFGS = optimiser) -> torch.Tensor:
            optimiser.zero_grad()
            loss = misfit(values)
            loss.backward()
            return loss

        optimiser.step(closure)
        loss = float(misfit(values.detach()))
        if loss < best[0]:
            best = (loss, values.detach())
    distance, right, down, _ = best[1].tolist()
    return distance, right, down


def main() -> None:
    """Render a letter rotated by 40 degrees, find its pose, and plot the expected autocorrelation before and after."""

    hidden = sim.load("tilted_letter", exposure=0.125)
    capture = sim.render(hidden, frames=2, seed=1)
    estimate, dof = estimate_autocorrelation(capture.frames, patches_of(hidden.geometry)[0])
    facing = setup_of(sim.load("corner_letter", exposure=0.125).geometry, 32)
    distance, right, down = recover(estimate, dof, facing)
    print(
        f"distance {distance:.4f} m (true 1), rotated right by {math.degrees(right):.1f} degrees (true 40), down by "
        f"{math.degrees(down):.1f} (true 0)"
    )

    found = facing.with_(detector_m=distance, tilt_right=right, tilt_down=down)
    images = {
        "expected, facing the wall": expected_autocorrelation(facing).detach().numpy(),
        "estimate from two frames": estimate - np.median(estimate),
        "expected, pose found": expected_autocorrelation(found).detach().numpy(),
    }
    _, axes = plt.subplots(1, 3, figsize=(10, 3.4), layout="constrained")
    for panel, (title, lags) in zip(axes, images.items(), strict=True):
        shown = dim_zero_lag(np.asarray(lags, np.float32))
        panel.imshow(shown, cmap="gray", extent=(-63.5, 63.5, 63.5, -63.5), vmin=0.0)
        panel.set(title=title, xlabel="lags")


if __name__ == "__main__":
    main()
