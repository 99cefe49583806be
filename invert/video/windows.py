"""For how long an object stays at rest, so that its fields can be retrieved together: the longest window of time over which r*r changes
less than the noise of the window lets see.

In a window of h frames before and after a time, the mean of r*r differs from the truth at that time by the mean of its second derivative.
Each frame is predicted twice by as many others: by the inner half of its window and by the outer half. Both predictions have the same
noise, so that the difference of their log-likelihoods is that of what has changed. With a mean squared distance of h^2 / 12, 7 h^2 / 12
and h^2 / 3 for inner half, outer half and window, the window loses a third of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invert.video.looks import MIN_OVER_FLOOR, Looks
from invert.video.turning import turn
from radiometry.noise.measured_noise import WHOLE_FRAME_INFLATION

LOST_BY_WINDOW = 1.0 / 3.0
"""Loss of a window over the difference of the losses of its outer and inner half, (1/3)^2 / ((7/12)^2 - (1/12)^2)."""

MIN_SIGMA = 2.0
"""Standard errors by which a change must exceed its limit."""

MAX_PART = 3.0 / 8.0
"""Largest half-width that is tried, in lengths of the capture; a quarter of its frames then has a whole window."""


@dataclass(frozen=True)
class Window:
    """A window of time: `half_width` frames on either side of its middle, or all frames of an object that stays the same."""

    half_width: int
    frames: int

    @property
    def holds_all(self) -> bool:
        """Whether each window holds every frame."""
        return 2 * self.half_width + 1 >= self.frames

    def around(self, middle: int) -> slice:
        """Return the frames of the window around one."""
        return slice(max(0, middle - self.half_width), middle + self.half_width + 1)

    def weights(self, middle: int) -> np.ndarray:
        """Return the weight of each frame in the mean of the window around one, (frames,)."""
        weights = np.zeros(self.frames)
        weights[self.around(middle)] = 1.0
        return weights / weights.sum()

    def middles(self) -> list[int]:
        """Return middles at most a half-width apart, so that no window reaches beyond the capture."""
        if self.holds_all:
            return [self.frames // 2]
        first, last = self.half_width, self.frames - 1 - self.half_width
        count = 1 + -(-(last - first) // max(self.half_width, 1))
        return [round(one) for one in np.linspace(first, last, count)]


def choose_window(looks: Looks) -> Window:
    """Return the longest window in which the object, at the angles of the looks, stays the same.

    The change is allowed to raise chi^2 of the window by a standard deviation: half the root of twice the number of lags, in nats.
    """
    count = len(looks.values)
    most = 0.5 * (2.0 * looks.whole.lag_grid.off_axis.sum() / WHOLE_FRAME_INFLATION) ** 0.5
    best = 1
    for half in half_widths(count):
        lost, error = change(looks, looks.upright, half)
        if lost - MIN_SIGMA * error > most:
            return Window(best, count)
        best = half
    return Window(count, count)


def half_widths(frames: int) -> list[int]:
    """Return the half-widths that are tried: even numbers, each about the root of two larger than the one before."""
    halves = 2.0 ** np.arange(0.0, np.log2(max(MAX_PART * frames / 2.0, 1.0)) + 1e-9, 0.5)
    return [2 * int(one) for one in np.unique(np.rint(halves))]


def change(looks: Looks, upright: np.ndarray, half: int) -> tuple[float, float]:
    """Return the log-likelihood in nats that a window of a half-width loses by the change of the object, and its standard error.

    Args:
        upright: values (frames, n, n) that were turned back.
        half: an even number.
    """
    count, used, inner = len(upright), looks.whole.lag_grid.off_axis, half // 2
    sums = np.concatenate([np.zeros((1, *upright.shape[1:])), np.cumsum(upright, 0, dtype=np.float64)])
    differences = []
    for number in range(half, count - half):
        near = sums[number + inner + 1] - sums[number - inner]
        far = sums[number + half + 1] - sums[number - half] - near
        scores = [_score(looks, number, others / half, used) for others in (near - upright[number], far)]
        differences.append(scores[0] - scores[1])
    scale = LOST_BY_WINDOW * looks.dof / WHOLE_FRAME_INFLATION * (2 * half + 1)
    return scale * float(np.mean(differences)), scale * float(np.std(differences, ddof=1) / len(differences) ** 0.5)


def _score(looks: Looks, number: int, expected: np.ndarray, used: np.ndarray) -> float:
    """Return the log-likelihood of a frame under a prediction at the angle of the first frame, per degree of freedom."""
    mean = turn(expected, looks.turns[number], looks.aspect, looks.floor)[used].clip(MIN_OVER_FLOOR * looks.floor)
    return -float((np.log(mean / looks.floor) + looks.values[number][used] / mean).sum())
