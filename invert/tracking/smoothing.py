"""Paths without what noise bends them by."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded


def smooth(path: np.ndarray, bend_error: np.ndarray) -> np.ndarray:
    """Return a path (frames, 2), from its first frame, whose displacements are smoothed as far as the second differences of the path are
    not significantly larger than those of noise, whose standard error is `bend_error` (2,) (Whittaker's smoother)."""
    steps, found = np.diff(path, axis=0), np.zeros_like(path)
    bends = np.diff(steps, axis=0)
    for axis, error in enumerate(bend_error):
        of_noise = max(error**2, 1e-12)
        of_motion = max(float(np.mean(bends[:, axis] ** 2)) - of_noise, of_noise * (8.0 / max(len(bends), 1)) ** 0.5)
        penalty = np.full(len(steps), 0.5 * of_noise / of_motion)
        bands = np.stack([-penalty, 1.0 + 2.0 * penalty, -penalty])
        bands[1, [0, -1]] -= penalty[0]  # no neighbour beyond the ends
        found[1:, axis] = np.cumsum(solve_banded((1, 1), bands, steps[:, axis]))
    return found
