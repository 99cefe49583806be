"""Paths without what noise bends them by."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.fft import dct, idct
from scipy.interpolate import interp1d
from scipy.ndimage import median_filter
from scipy.stats import chi2

from invert.tracking.register import solve_pairs

FALSE_ALARM = 0.01
"""Probability that noise alone gives a path a periodic part, or a jump, that is kept."""

RATES = np.concatenate([[0.0], np.logspace(-8.0, 2.0, 101)])
"""Variances of the change of a step from one frame to the next that are tried, over that of the noise of a step."""

BESIDE, MAX_JUMPS = 5, 0.1
"""Number of steps around a jump whose median is that without it, and part of the steps above which they are none."""

MIN_NOISE = 1e-4
"""Least variance of a coefficient over that of the largest."""

MAX_STEPS = 1024
"""Number of steps from which spectra of longer paths are interpolated."""

ROUNDS = 3


@dataclass(frozen=True)
class PathNoise:
    """Noise of a path whose positions were registered in pairs; white noise of the steps for a reach of 1.

    Attributes:
        of_pair: variance of the displacement of a pair, (2,) squared pixels.
        reach: number of positions on each side that each was registered to.
        length: number of frames in a group that has one position; the path is straight between their middles.
    """

    of_pair: np.ndarray = field(default_factory=lambda: np.zeros(2))
    reach: int = 1
    length: int = 1

    @property
    def bend_error(self) -> np.ndarray:
        """Standard error of a second difference of positions in consecutive frames, far from the ends, (2,)."""
        count = 6 * self.reach + 3
        bend = np.zeros((count, 1))
        bend[count // 2 - 1 : count // 2 + 2, 0] = 1.0, -2.0, 1.0
        # A straight path bends once per group, by a step over its length, which is spread over two frames.
        bends = 2.0 * self.length**3 if self.length > 1 else 1.0
        return np.sqrt(self.of_pair * self._over_pair(bend) / bends)

    def of_steps(self, count: int) -> np.ndarray:
        """Return the variances of the coefficients of a cosine transform of steps, (count, 2).

        All pairs of positions within the reach are registered with the same variance. The displacements of the pairs then tell slow changes
        best: far from the ends, the variance falls with frequency to that of a pair over the sum of the squared distances of the pairs.
        """
        if not count:
            return np.zeros((0, 2))
        if count > MAX_STEPS:
            return _at_frequencies_of(count, self.of_steps(MAX_STEPS))
        steps = np.diff(self._lines(count + 1), axis=0)
        shape = self._over_pair(steps.T @ idct(np.eye(count), axis=0, norm="ortho"))
        return np.maximum(np.maximum(shape, MIN_NOISE * shape.max())[:, None] * self.of_pair, 1e-12)

    def _over_pair(self, sums: np.ndarray) -> np.ndarray:
        """Return the variances of weighted sums of positions, weights (positions, n), over that of the displacement of a pair, (n,)."""
        return (sums * solve_pairs(sums, self.reach, np.ones(len(sums)))).sum(0)

    def _lines(self, frames: int) -> np.ndarray:
        """Return the contributions of positions to frames, (frames, positions): straight lines between the middles of groups."""
        groups = np.array_split(np.arange(frames), max(2, frames // self.length))
        known = [group.mean() for group in groups]
        return interp1d(known, np.eye(len(known)), axis=0, fill_value="extrapolate")(np.arange(frames))


def smooth(path: np.ndarray, noise: PathNoise) -> np.ndarray:
    """Return a path (frames, 2), from its first frame, whose steps are smoothed as far as noise may have changed them.

    Steps are the sum of a random walk, of noise, and of periodic parts. In the discrete cosine transform of the steps, a random walk
    that changes by a variance q per frame has the variance q / (2 - 2 cos(pi k / n)) at frequency k; the likelihood of the coefficients
    tells q, and the conditional mean (Wiener's filter) the steps. Coefficients too large for it are periodic parts, such as a vibration,
    and stay; so do single steps too large for it, such as a jump.
    """
    steps, found = np.diff(path, axis=0), np.zeros_like(path)
    for axis, variances in enumerate(noise.of_steps(len(steps)).T):
        found[1:, axis] = np.cumsum(_smooth_steps(steps[:, axis], variances)[0])
    return found


def error_in_groups(path: np.ndarray, noise: PathNoise, size: int) -> np.ndarray:
    """Return the rms standard error of the positions of a smoothed path (frames, 2) about the means of groups of some frames, (2,).

    The variance that is left of a coefficient, given the path, is the variance of its noise times the part of it that the filter keeps.
    """
    steps = np.diff(path, axis=0)
    few = min(len(steps), MAX_STEPS)
    places = np.cumsum(idct(np.eye(few), axis=0, norm="ortho"), 0)  # of the frames after the first, by each coefficient
    places = np.concatenate([np.zeros((1, few)), places])[: (few + 1) // size * size].reshape(-1, size, few)
    spread = _at_frequencies_of(len(steps), places.var(1).mean(0)) * few / len(steps)
    variances = noise.of_steps(len(steps)).T
    left = [spread @ (one * _smooth_steps(steps[:, axis], one)[1]) for axis, one in enumerate(variances)]
    return np.sqrt(left)


def _at_frequencies_of(count: int, values: np.ndarray) -> np.ndarray:
    """Return values (n, ...) at the frequencies of a cosine transform at those of one of a number of steps, (count, ...)."""
    if count == len(values):
        return values
    return interp1d(np.arange(len(values)) / len(values), values, axis=0, fill_value="extrapolate")(np.arange(count) / count)


def _smooth_steps(seen: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return smoothed steps (n,), and the part of each coefficient of their cosine transform that is kept, (n,).

    Args:
        noise: variances of the coefficients, (n,).
    """
    if not len(seen):
        return seen, np.ones(0)
    usual = float(noise.mean())
    walk = 1.0 / (2.0 - 2.0 * np.cos(np.pi * np.arange(1, len(seen)) / len(seen)))
    highest = chi2.isf(FALSE_ALARM / max(len(seen), 1), 1)
    apart = seen - median_filter(seen, BESIDE, mode="nearest")
    is_jump = apart**2 > highest * usual
    jumps = np.where(is_jump, apart, 0.0) if is_jump.mean() < MAX_JUMPS else np.zeros(len(seen))
    gains = np.ones(len(seen))
    for _ in range(ROUNDS):
        waves = dct(seen - jumps, norm="ortho")
        gains[1:] = _gains(waves[1:] ** 2 / noise[1:], walk * usual / noise[1:], highest)
        kept = idct(gains * waves, norm="ortho")
        jumps = np.where((seen - kept) ** 2 > highest * usual, seen - kept, 0.0)
    return kept + jumps, gains


def _gains(power: np.ndarray, walk: np.ndarray, highest: float) -> np.ndarray:
    """Return the part of each coefficient that is motion.

    Args:
        power: squared coefficients over the variance of the noise, (n - 1,).
        walk: variances of the coefficients of a random walk that changes by a variance of one per frame, over that of the noise.
        highest: power of a coefficient over the expected one, above which it is a periodic part.
    """
    expected = 1.0 + np.outer(RATES, walk)
    is_periodic = np.zeros(len(power), bool)
    for _ in range(ROUNDS):
        unlikely = (np.log(expected) + power / expected)[:, ~is_periodic].sum(1)
        chosen = expected[int(unlikely.argmin())]
        is_periodic = power > highest * chosen
    return np.where(is_periodic, 1.0, 1.0 - 1.0 / chosen)
