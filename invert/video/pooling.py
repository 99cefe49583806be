"""Weights by which frames are pooled: r*r of an object that changes is a combination of a few patterns, each of which all frames show.

The singular values of r*r over time, in units of its noise, show how many patterns exceed the noise. Projected on the course of these in
time, r*r at each time is a weighted sum over all frames. The weights of an object that stays the same are those of the noise of the frames;
a movement that repeats is pooled over its repetitions, and one that is short changes only the weights around it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invert.measure.spectrum import read_measurement
from invert.video.looks import MIN_OVER_FLOOR, Looks
from radiometry.noise.measured_noise import WHOLE_FRAME_INFLATION


@dataclass(frozen=True)
class Pooling:
    """Weights of the frames.

    Attributes:
        weights: weight of each frame at each time, (frames, frames); rows add up to 1.
        frames: number of frames whose mean would have the noise of an image, on average over time.
        patterns: number of patterns of change; 0 for an object that stays the same.
    """

    weights: np.ndarray
    frames: float
    patterns: int

    def times(self, most: int) -> np.ndarray:
        """Return the numbers of the frames at whose times images are reconstructed: at most so many, and one of an object that stays the
        same."""
        count = len(self.weights)
        return np.array([count // 2]) if self.patterns == 0 else spread(count, most)


def pool(looks: Looks) -> Pooling:
    """Return the weights by which frames are pooled, at the angles of the looks."""
    every, noise = looks.upright, looks.noise
    mean = np.average(every, 0, noise**-2.0)
    measured = read_measurement(mean.astype(np.float32))
    used = looks.whole.lag_grid.off_axis & (looks.whole.lag_grid.ring <= measured.noise.signal_ring)
    change = (every[:, used] / np.maximum(mean[used], MIN_OVER_FLOOR * looks.floor) - 1.0) / looks.deviations(mean[used])
    courses, sizes, _ = np.linalg.svd(change, full_matrices=False)
    lags = used.sum() / WHOLE_FRAME_INFLATION  # as many as are independent
    median = np.median(sizes[: min(len(every) - 1, int(lags))])
    patterns = int((sizes > threshold_over_median(len(every) / lags) * median).sum())
    # In units of noise, what stays the same has the course 1 / noise.
    shown, _ = np.linalg.qr(np.column_stack([1.0 / noise, courses[:, :patterns]]))
    weights = noise[:, None] * (shown @ shown.T) / noise
    return Pooling(weights, float(looks.equivalent_frames(weights).mean()), patterns)


def spread(count: int, most: int) -> np.ndarray:
    """Return the numbers of at most so many of `count` frames, equally spaced, with the first and the last."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(most, count))).astype(int))


def threshold_over_median(aspect: float) -> float:
    """Return the singular value over the median of those of noise, above which a pattern lowers the mean squared error; `aspect` is the
    number of frames over that of lags (Gavish and Donoho, doi:10.1109/TIT.2014.2323359)."""
    aspect = min(aspect, 1.0 / aspect)
    return 0.56 * aspect**3 - 0.95 * aspect**2 + 1.82 * aspect + 1.43
