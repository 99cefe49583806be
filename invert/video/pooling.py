"""Weights by which frames are pooled: r*r of an object that changes is a combination of a few patterns, each of which all frames show.

The singular values of r*r over time, in units of its noise, show how many patterns exceed the noise. Projected on the course of these in
time, r*r at each time is a weighted sum over all frames. The weights of an object that stays the same are those of the noise of the frames;
a movement that repeats is pooled over its repetitions, and one that is short changes only the weights around it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from invert.assess.doubts import FALSE_ALARMS_EACH, Doubt, DoubtKind
from invert.measure.spectrum import read_measurement
from invert.video.looks import MIN_OVER_FLOOR, Looks
from radiometry.noise.measured_noise import WHOLE_FRAME_INFLATION

KNOWN_NOISE = 0.05
"""Part of the variance of r*r by which its noise may differ from theory."""


@dataclass(frozen=True)
class Pooling:
    """Weights of the frames.

    Attributes:
        weights: weight of each frame at each time, (frames, frames); rows add up to 1.
        frames: number of frames whose mean would have the noise of an image, on average over time.
        patterns: number of patterns of change; 0 for an object that stays the same.
        has_one_image: whether one image shows all times: the object stays the same, and no frame is dark.
        doubts: the doubt that an object without patterns of change changes all the same.
    """

    weights: np.ndarray
    frames: float
    patterns: int
    has_one_image: bool
    doubts: tuple[Doubt, ...]

    def times(self, most: int) -> np.ndarray:
        """Return the numbers of the frames at whose times images are reconstructed, at most so many."""
        count = len(self.weights)
        return np.array([count // 2]) if self.has_one_image else spread(count, most)


def pool(looks: Looks) -> Pooling:
    """Return the weights by which frames are pooled, at the angles of the looks."""
    every, noise, grid = looks.upright, looks.noise, looks.whole.lag_grid
    mean = np.average(every, 0, noise**-2.0)
    measured = read_measurement(mean.astype(np.float32))
    used = mean[grid.off_axis]
    change = (every[:, grid.off_axis] / np.maximum(used, MIN_OVER_FLOOR * looks.floor) - 1.0) / looks.deviations(used)
    is_signal = grid.ring[grid.off_axis] <= measured.noise.signal_ring
    courses, sizes, _ = np.linalg.svd(change[:, is_signal], full_matrices=False)
    variance = _noise_variance(looks, change[:, ~is_signal])
    patterns = int((sizes**2 > variance * _largest_of_noise(len(every), int(is_signal.sum()))).sum())
    # In units of noise, what stays the same has the course 1 / noise.
    shown, _ = np.linalg.qr(np.column_stack([1.0 / noise, courses[:, :patterns]]))
    weights = noise[:, None] * (shown @ shown.T) / noise
    has_one_image = patterns == 0 and not looks.are_dark.any()
    doubts = () if patterns else (_doubt_constancy(change[~looks.are_dark][:, is_signal], variance, looks.dof),)
    return Pooling(weights, float(looks.equivalent_frames(weights).mean()), patterns, has_one_image, doubts)


def _noise_variance(looks: Looks, outside: np.ndarray) -> float:
    """Return the variance of the noise of changes: one over K of a frame, or what the lags beyond the object show, if it is more.

    Args:
        outside: changes at the lags beyond the object, (frames, k).
    """
    seen = outside[~looks.are_dark]
    return max(1.0 / looks.dof, float((seen**2).mean()) / (1.0 - 1.0 / len(seen)) if seen.size else 0.0)


def _largest_of_noise(frames: int, lags: int) -> float:
    """Return the square of the singular value of changes at a number of lags above which a pattern lowers the mean squared error, over the
    variance of the noise (Gavish and Donoho, doi:10.1109/TIT.2014.2323359)."""
    independent = lags / WHOLE_FRAME_INFLATION
    aspect = min(frames / independent, independent / frames)
    best = 2.0 * (aspect + 1.0) + 8.0 * aspect / (aspect + 1.0 + (aspect**2 + 14.0 * aspect + 1.0) ** 0.5)
    return best * WHOLE_FRAME_INFLATION * max(frames, independent)


def _doubt_constancy(change: np.ndarray, variance: float, dof: float) -> Doubt:
    """Return the doubt that r*r, whose Gamma noise has a variance and K degrees of freedom, changes in ways too faint for any pattern, from
    changes (frames, lags)."""
    degrees = change.shape[1] * (len(change) - 1)
    excess = float((change**2).sum()) / (variance * max(degrees, 1)) - 1.0
    by_chance = float(norm.isf(FALSE_ALARMS_EACH)) * ((2.0 + 6.0 / dof) * WHOLE_FRAME_INFLATION / max(degrees, 1)) ** 0.5
    advice = (
        f"r*r varies from frame to frame by {100.0 * excess:.0f} % more than its noise, too little for images at single times: the object "
        "may change, and the film shows its mean; take more frames or more light"
    )
    return Doubt(DoubtKind.DIFFERENT_FRAMES, excess, KNOWN_NOISE + by_chance, FALSE_ALARMS_EACH, advice)


def spread(count: int, most: int) -> np.ndarray:
    """Return the numbers of at most so many of `count` frames, equally spaced, with the first and the last."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(most, count))).astype(int))
