"""Paths without what noise bends them by."""

from __future__ import annotations

import numpy as np
from scipy.fft import dct, idct
from scipy.ndimage import median_filter
from scipy.stats import chi2

FALSE_ALARM = 0.01
"""Probability that noise alone gives a path a periodic part, or a jump, that is kept."""

RATES = np.concatenate([[0.0], np.logspace(-8.0, 2.0, 101)])
"""Variances of the change of a step from one frame to the next that are tried, over that of the noise of a step."""

BESIDE, MAX_JUMPS = 5, 0.1
"""Number of steps around a jump whose median is that without it, and part of the steps above which they are none."""

ROUNDS = 3


def smooth(path: np.ndarray, bend_error: np.ndarray) -> np.ndarray:
    """Return a path (frames, 2), from its first frame, whose steps are smoothed as far as noise may have changed them.

    Steps are the sum of a random walk, of white noise, and of periodic parts. In the discrete cosine transform of the steps, a random walk
    that changes by a variance q per frame has the variance q / (2 - 2 cos(pi k / n)) at frequency k; the likelihood of the coefficients
    tells q, and the conditional mean (Wiener's filter) the steps. Coefficients too large for it are periodic parts, such as a vibration,
    and stay; so do single steps too large for it, such as a jump.

    Args:
        bend_error: standard error of a second difference of the path, (2,), which is the root of 2 times that of a step.
    """
    steps, found = np.diff(path, axis=0), np.zeros_like(path)
    walk = 1.0 / (2.0 - 2.0 * np.cos(np.pi * np.arange(1, len(steps)) / len(steps)))
    highest = chi2.isf(FALSE_ALARM / max(len(steps), 1), 1)
    for axis, error in enumerate(bend_error):
        seen, noise = steps[:, axis], max(0.5 * error**2, 1e-12)
        apart = seen - median_filter(seen, BESIDE, mode="nearest")
        is_jump = apart**2 > highest * noise
        jumps = np.where(is_jump, apart, 0.0) if is_jump.mean() < MAX_JUMPS else np.zeros(len(steps))
        for _ in range(ROUNDS):
            waves = dct(seen - jumps, norm="ortho")
            waves[1:] *= _gains(waves[1:] ** 2 / noise, walk, highest)
            kept = idct(waves, norm="ortho")
            jumps = np.where((seen - kept) ** 2 > highest * noise, seen - kept, 0.0)
        found[1:, axis] = np.cumsum(kept + jumps)
    return found


def _gains(power: np.ndarray, walk: np.ndarray, highest: float) -> np.ndarray:
    """Return the part of each coefficient that is motion.

    Args:
        power: squared coefficients over the variance of the noise, (n - 1,).
        walk: variances of the coefficients of a random walk that changes by a variance of one per frame.
        highest: power of a coefficient over the expected one, above which it is a periodic part.
    """
    expected = 1.0 + np.outer(RATES, walk)
    is_periodic = np.zeros(len(power), bool)
    for _ in range(ROUNDS):
        unlikely = (np.log(expected) + power / expected)[:, ~is_periodic].sum(1)
        chosen = expected[int(unlikely.argmin())]
        is_periodic = power > highest * chosen
    return np.where(is_periodic, 1.0, 1.0 - 1.0 / chosen)
