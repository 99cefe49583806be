"""Turn and scale of autocorrelations, from their values on rings around zero lag.

If an object turns about the line of sight, the expected r*r turns with it, whether the laser moves or not (doi:10.1364/AO.57.000905), and
its width in lags is inversely proportional to the distance. On rings around zero lag it is a Fourier series in the angle; a turn by phi
multiplies coefficient m by exp(-i m phi). Only even m occur, because r*r is symmetric, so an angle is known up to half a turn: it is
taken to change by less than a quarter turn from group to group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import ndimage

FIRST_RING = 2.5
"""Radius of the first ring in lags, beyond the peak at zero lag."""

RING_STEP = 1.0
"""Distance between rings in lags, whose noise is then nearly independent."""

ANGLES = 180
"""Samples of half a ring; the other half is the same."""

FINE_ANGLES = 1440
"""Turns at which the correlation of two groups is computed."""

SMOOTHING_SIDES = (3, 9)
"""Rings and angles over which the power of the noise is averaged."""

MIN_POWER = 6.0
"""Minimum power of a coefficient of the mean in units of its noise; noise alone exceeds it with a probability of exp(-6)."""

ROUNDS = 6
"""Rounds of registration to the mean of all groups."""


@dataclass(frozen=True)
class Turns:
    """Angles in radians and relative scales of r*r in each group, (groups,), from the first one.

    `significance` is the smallest correlation of consecutive groups at their turn, in standard deviations.
    """

    angle: np.ndarray
    scale: np.ndarray
    significance: float


class Rings:
    """Autocorrelations on half rings around zero lag.

    Args:
        estimates: r*r of each group without floor (groups, n, n), zero lag in the middle.
        aspect: pitch of a lag along rows over that along columns.
    """

    def __init__(self, estimates: np.ndarray, aspect: float) -> None:
        self._smooth = [ndimage.spline_filter(one.astype(np.float64), 3) for one in estimates]
        self._aspect, self._middle = aspect, estimates.shape[-1] // 2
        self.radius = np.arange(FIRST_RING, self._middle / 1.3, RING_STEP)
        self.order = 2.0 * np.arange(ANGLES // 2 + 1)
        # noise of lags is white, so a ring has no noise beyond pi times its radius
        self.is_used = (self.order > 0) & (self.order < np.pi * self.radius[:, None])

    def series(self, group: int, angle: float, scale: float) -> np.ndarray:
        """Return the coefficients (rings, orders) of a group, turned back by an angle and scaled back."""
        turn = np.pi * np.arange(ANGLES) / ANGLES + angle
        radius = scale * self.radius[:, None]
        root = self._aspect**0.5  # both axes in units of the geometric mean of the pitches
        places = (self._middle + radius * np.sin(turn) / root, self._middle + radius * np.cos(turn) * root)
        values = ndimage.map_coordinates(self._smooth[group], places, order=3, prefilter=False)
        return np.where(self.is_used, np.fft.rfft(values, axis=1) / ANGLES, 0.0)

    def on_rings(self, series: np.ndarray) -> np.ndarray:
        """Return the values (..., rings, angles) of coefficients."""
        return np.fft.irfft(series * ANGLES, ANGLES)


def find_turns(estimates: np.ndarray, aspect: float = 1.0) -> Turns:
    """Return the turns of all groups; see `Rings` for the arguments.

    Each group is registered to the mean of the others, by least squares in angle, scale and brightness.
    """
    rings, count = Rings(estimates, aspect), len(estimates)
    angle, significance = _first_angles(rings, count)
    scale = np.ones(count)
    for _ in range(ROUNDS):
        series = np.stack([rings.series(group, *state) for group, state in enumerate(zip(angle, scale, strict=True))])
        residual = series - series.mean(0)
        variance = ndimage.uniform_filter(
            (rings.on_rings(residual) ** 2).sum(0) / (count - 1), SMOOTHING_SIDES, mode=("nearest", "wrap")
        )
        # without the group itself, whose own noise would hold it where it is
        others = (series.sum(0) - series) / (count - 1)
        noise = (np.abs(residual) ** 2).sum((0, 2)) / rings.is_used.sum(1) / (count - 1) ** 2
        others = np.where(np.abs(others) ** 2 > MIN_POWER * noise[:, None], others, 0.0)
        weight = 1.0 / variance.clip(1e-9 * variance.max() + 1e-300)
        change = np.array([_fit(rings, one, mean, weight) for one, mean in zip(series, others, strict=True)])
        angle, scale = angle - change[:, 0], scale * np.exp(-change[:, 1])
    return Turns(angle[0] - angle, scale / scale[0], significance)


def _first_angles(rings: Rings, count: int) -> tuple[np.ndarray, float]:
    """Return approximate angles and `Turns.significance`: the correlation of consecutive groups, continued over half turns, then the mean
    over all pairs.
    """
    series = [rings.series(group, 0.0, 1.0) for group in range(count)]
    power = np.abs(series) ** 2
    outer = len(rings.radius) * 2 // 3  # beyond the object
    every = (rings.radius[outer:, None] * power[:, outer:] * rings.is_used[outer:]).sum((1, 2)) / rings.is_used[outer:].sum()
    noises = every[:, None, None] / rings.radius[:, None] + 1e-300  # of each group
    noise = noises.mean(0)
    signal = np.where(rings.is_used, (power.mean(0) - noise).clip(0.0), 0.0)
    weight = signal / (noise * (2.0 * signal + noise))  # Knapp and Carter, doi:10.1109/TASSP.1976.1162830

    def turn_between(one: int, other: int, about: float) -> tuple[float, float]:
        """Return the turn from one group to another that is nearest to an angle, and the correlation there in standard deviations."""
        cross = np.fft.irfft((weight * series[one] * series[other].conj()).sum(0), FINE_ANGLES) * (0.5 * FINE_ANGLES)
        found = -np.pi * float(np.argmax(cross)) / FINE_ANGLES
        chance = np.sqrt(0.5 * (weight**2 * (signal + noises[one]) * (signal + noises[other])).sum()) + 1e-300
        return about + (found - about + 0.5 * np.pi) % np.pi - 0.5 * np.pi, float(cross.max() / chance)

    steps = np.array([turn_between(number, number + 1, 0.0) for number in range(count - 1)])
    angle = np.concatenate(([0.0], np.cumsum(steps[:, 0])))
    turns = np.zeros((count, count))
    for one, other in combinations(range(count), 2):
        turns[one, other] = turn_between(one, other, angle[other] - angle[one])[0]
    return (angle[:, None] + turns - turns.T).mean(0), float(steps[:, 1].min())


def _fit(rings: Rings, series: np.ndarray, mean: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return by how much angle and logarithm of the scale of a group exceed those of a mean, (2,).

    Args:
        series, mean: coefficients of the group and of the mean.
        weight: inverse variance of the values (rings, angles).
    """
    spread = rings.radius[:, None] * np.gradient(mean, rings.radius, axis=0)
    basis = rings.on_rings(np.stack([1j * rings.order * mean, spread, mean]))
    matrix = np.einsum("iro,jro,ro->ij", basis, basis, weight)
    return (np.linalg.pinv(matrix) @ np.einsum("ro,jro,ro->j", rings.on_rings(series - mean), basis, weight))[:2]


def group_means(estimates: Sequence[np.ndarray], size: int, weights: np.ndarray) -> np.ndarray:
    """Return the means of consecutive groups of estimates with weights (n,); what fills no group is left out."""
    groups = [slice(first, first + size) for first in range(0, len(estimates) + 1 - size, size)]
    return np.stack([np.average(estimates[one], 0, weights[one]) for one in groups])
