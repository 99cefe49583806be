"""
Recover a pose by gradient descent
==================================

How far away a known letter hangs and how it is turned, from two speckle frames: ``sim.gradients`` differentiates the expected
autocorrelation, and the Gamma likelihood of the estimate is climbed from several starts.
"""

from __future__ import annotations

import math

import numpy as np
import torch

import sim
from radiometry.estimation.whole_frames import estimate_autocorrelation
from radiometry.noise.level import HALF_PLANE
from radiometry.prediction import patches_of
from sim.gradients import Setup, expected_autocorrelation, setup_of

STARTS = [(distance, tilt) for distance in (0.8, 1.0, 1.3) for tilt in (-0.6, 0.6)]


def recover(estimate: np.ndarray, dof: float, known: Setup, steps: int = 60) -> tuple[float, float, float]:
    """Distance in metres and turns (right, down) in radians of greatest Gamma likelihood, from several starts.

    Args:
        estimate: (127, 127) of frames in photoelectrons. known: everything but the pose.
    """
    lags = torch.from_numpy(estimate.astype(np.float64))
    seen = torch.from_numpy(HALF_PLANE)

    def misfit(values: torch.Tensor) -> torch.Tensor:
        distance, right, down, floor = values
        # The wall moves with its frame; the spot stays where it is.
        expected = expected_autocorrelation(known.with_(detector_m=distance, tilt_right=right, tilt_down=down)) + floor.exp()
        return dof * (expected.log() + lags / expected)[seen].mean()

    best = (math.inf, torch.zeros(4))
    for distance, tilt in STARTS:
        # A small turn down: the misfit is even in it for a letter that faces the wall.
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
    hidden = sim.load("tilted_letter", exposure=0.125)
    capture = sim.render(hidden, frames=2, seed=1)
    grid = patches_of(hidden.geometry)[0]
    estimate, dof = estimate_autocorrelation(capture.frames, grid)
    facing = sim.load("corner_letter", exposure=0.125)
    distance, right, down = recover(estimate, dof, setup_of(facing.geometry, 32))
    print(
        f"distance {distance:.4f} m (1), turned right by {math.degrees(right):.1f} degrees (40), down by "
        f"{math.degrees(down):.1f} (0)"
    )


if __name__ == "__main__":
    main()
