"""r*r of each frame on common lags, and weighted sums of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from tqdm import tqdm

from correlograph.errors import InputError
from correlograph.files.capture import Capture
from invert.measure.estimate import Estimate
from invert.request import Request
from invert.tracking.rotation import relative_light
from invert.video.turning import turn
from radiometry.estimation.autocorrelation_estimator import estimator_of
from radiometry.noise.measured_noise import fill_zero_lag, read_noise_level

MIN_OVER_FLOOR = 1e-3
"""Least r*r over its floor to which noise is proportional."""

MIN_POWER = 0.01
"""Power of a frame over the usual one, below which it cannot show what others show: with a hundredth of the light in faint frames, a tenth
in bright ones."""


NOISE_OF_DARKNESS = 1e3
"""Noise of a frame without light over the usual one."""


@dataclass(frozen=True)
class Looks:
    """r*r of each frame, as if all had the same light.

    Attributes:
        values: (frames, n, n), with one noise floor; static patterns are subtracted, zero lag is a mean of those around it.
        whole: estimate from all frames, whose lags and metadata these share.
        angle_deg: angle of the object in each frame, (frames,); zero where it is not followed.
        floors: noise floor of each frame for the same light, (frames,): a frame of less light has a higher one.
        are_dark: whether a frame has next to no light compared with others, (frames,).
    """

    values: np.ndarray
    whole: Estimate
    angle_deg: np.ndarray
    floors: np.ndarray
    are_dark: np.ndarray

    @classmethod
    def of(cls, capture: Capture, whole: Estimate, request: Request) -> Looks:
        """Estimate r*r of each frame on the lags of an estimate from all of them. Raises InputError for frames of a single patch."""
        assert whole.record is not None
        grid = whole.record.grid
        if grid.count < 2:
            found = f"{grid.frame_shape[0]} x {grid.frame_shape[1]} pixels, patches of {grid.size}"
            raise InputError("frames", "two patches or more in each frame of a film", found, "use larger frames")
        values, levels = [], []
        for frame in tqdm(capture.frames, desc="autocorrelations", unit="frame", disable=None, leave=False):
            estimator = estimator_of(grid, whole.record.background.mean, request.device)
            estimator.add(frame)
            values.append(_fill_zero_lag_by_neighbours(estimator.estimate()))
            levels.append(float(np.mean(frame)))
        every = np.stack(values)
        power, at_rest = every.mean((1, 2)), every.mean(0) - _fill_zero_lag_by_neighbours(whole.values)
        are_dark = power < MIN_POWER * np.median(power[power > 0.0])
        every /= relative_light(levels)[:, None, None]
        if whole.record.background.fixed_pattern_lags:  # its light is taken to drift as that of the laser
            every -= at_rest
        floors = np.array([read_noise_level(one).floor for one in every])
        floors = np.maximum(floors, MIN_OVER_FLOOR * float(np.median(np.abs(every[~are_dark]))))
        usual = usual_floor(floors[~are_dark])
        every -= (floors - usual)[:, None, None]
        return cls(every, whole, np.zeros(len(every)), np.where(are_dark, NOISE_OF_DARKNESS * usual, floors), are_dark)

    @property
    def turns(self) -> np.ndarray:
        """Angle of the object in each frame relative to the first, (frames,)."""
        return self.angle_deg - self.angle_deg[0]

    @property
    def aspect(self) -> float:
        """Pitch of the lags along rows over that along columns."""
        pitches = self.whole.pitches_m
        return 1.0 if pitches is None else pitches[0] / pitches[1]

    @property
    def dof(self) -> float:
        """Degrees of freedom K of a frame in theory."""
        assert self.whole.record is not None
        return self.whole.record.dof_expected / len(self.values)

    @cached_property
    def mean(self) -> np.ndarray:
        """Mean over all frames, weighted by their noise, (n, n)."""
        return np.average(self.values, 0, self.floors**-2.0)

    @cached_property
    def floor(self) -> float:
        """Noise floor of the mean."""
        return read_noise_level(self.mean).floor

    @cached_property
    def noise(self) -> np.ndarray:
        """Standard deviation of the noise of each frame over the usual one, (frames,), in the mean over the lags."""
        over_mean = self.deviations(self.mean[self.whole.lag_grid.off_axis])
        noise = np.sqrt((over_mean**2).mean(1))
        return noise * float((noise**-2.0).mean()) ** 0.5

    def deviations(self, mean: np.ndarray) -> np.ndarray:
        """Return the noise of each frame at some lags (k,) of known mean, over that of a frame of the usual floor, (frames, k): it is
        proportional to r*r with its own floor."""
        usual = np.maximum(mean, MIN_OVER_FLOOR * self.floor)
        excess = self.floors - usual_floor(self.floors)
        return np.maximum(usual + excess[:, None], MIN_OVER_FLOOR * self.floor) / usual

    def with_angles(self, angle_deg: np.ndarray) -> Looks:
        """Return the same with the angle of the object in each frame, (frames,)."""
        return replace(self, angle_deg=angle_deg)

    @cached_property
    def upright(self) -> np.ndarray:
        """The values (frames, n, n) as if the object had the angle of the first frame."""
        return np.stack(
            [turn(one, -angle, self.aspect, self.floor) for one, angle in zip(self.values, self.turns, strict=True)]
        )

    def equivalent_frames(self, weights: np.ndarray) -> np.ndarray:
        """Return the number of frames whose mean would have the noise of a weighted sum, (...), with weights (..., frames)."""
        return 1.0 / ((weights * self.noise) ** 2).sum(-1)

    def combine(self, values: np.ndarray, weights: np.ndarray) -> Estimate:
        """Return the estimate from a weighted sum of values (frames, n, n), with weights (frames,) that add up to 1."""
        frames = float(self.equivalent_frames(weights))
        record = replace(self.whole.record, frames=max(2, round(frames)), dof_expected=self.dof * frames)
        values = np.tensordot(weights, values, 1).clip(MIN_OVER_FLOOR * self.floor).astype(np.float32)
        return replace(self.whole, values=values, record=record, filtered_frames=None)


def usual_floor(floors: np.ndarray) -> float:
    """Return the noise floor of the mean of frames, weighted by their noise, from the floor of each, (frames,)."""
    return float(np.average(floors, weights=floors**-2.0))


def _fill_zero_lag_by_neighbours(values: np.ndarray) -> np.ndarray:
    middle = len(values) // 2
    beside = [values[middle + row, middle + column] for row, column in ((0, 1), (1, 0), (1, 1), (1, -1))]
    return fill_zero_lag(values, float(np.mean(beside)))
