"""The most likely paths of objects near approximate ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invert.tracking.fading import FadingLikelihood

EARLY, ROUNDS, GAIN = 2, 24, 0.05
"""Rounds in which only powers are fitted, and of all; and gain in a round, per cell, at which the maximum is found."""

RIDGE = 1e-3
"""Part by which the information is raised, so that velocities without any stay."""

SHORTER = 0.25
"""Part of a step that is tried when the whole leads down."""


def climb(likelihood: FadingLikelihood, begun: Sequence[np.ndarray], step_pixels: float) -> tuple[list[np.ndarray], float]:
    """Return paths at a maximum of their likelihood near begun ones, (frames, 2) each, and its height.

    Constant velocities that are added to the paths follow by Fisher scoring, together with all powers. They change by at most some pixels
    per frame in a round.
    """
    paths, height, step = list(begun), -np.inf, np.zeros((len(begun), 2))
    numbers, powers = np.arange(len(begun[0]))[:, None], likelihood.begin(len(begun))
    for number in range(ROUNDS):
        tried = [path + numbers * one for path, one in zip(paths, step, strict=True)]
        found = likelihood.step(tried, powers, moves=number >= EARLY)
        if found.height < height:
            step = SHORTER * step
            continue
        gain, paths, height, powers = found.height - height, tried, found.height, found.powers
        if number > EARLY and gain < GAIN * likelihood.cells:
            break
        if number >= EARLY:
            information = found.information + np.diag(RIDGE * found.information.diagonal() + 1e-30)
            step = np.linalg.solve(information, found.slope.ravel()).reshape(-1, 2)
            step /= max(1.0, float(np.abs(step).max()) / step_pixels)
    return paths, height
