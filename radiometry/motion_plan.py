"""Exposure for a moving object that its frames follow: how long, how many, and how precise image and path become.

An object moves by u while the laser is at rest. Its speckle travels by the travel matrix times u, and frames are added along its path. A
group of frames is then an exposure in which only the illumination changes: by M of its duration, with fringes at rest
(`radiometry/motion.py`). Long groups have more light per speckle, and less of its contrast.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from correlograph.errors import InputError, check_positive
from radiometry.motion import MAX_TURNS, Motion
from radiometry.noise.predicted_floor import estimate_error
from radiometry.prediction import Prediction, predict

MIN_GROUPS = 2
"""Minimum number of groups in which frames are added."""

MAX_DOUBLINGS = 16

MAX_POINTS = 10_000
"""Number of distances between groups at which their likeness is computed; of more, the mean of these stands for all."""

MAX_ERROR = 10.0
"""Relative error of r*r beyond which a plan says that no object can be detected: a thousand lags have a significance of three then."""


@dataclass(frozen=True)
class MotionPlan:
    """Plan for an object that moves uniformly.

    Attributes:
        exposure_s: longest exposure of a frame that does not blur the speckle.
        frames: number of frames, each of which begins when the one before ends.
        frames_per_group: number of consecutive frames that are added along the path.
        error: predicted relative error of r*r, rms over all lags; error_unfollowed: without adding.
        path_error_m: standard error of the position of the object in one group (rows, columns), the Cramer-Rao bound for a known
            pattern that does not change. Tracked paths have two to three times this, and errors by the illumination besides.
        speed_m_s: speed across the line of sight.
    """

    exposure_s: float
    frames: int
    frames_per_group: int
    error: float
    error_unfollowed: float
    path_error_m: tuple[float, float]
    speed_m_s: float

    def describe(self) -> str:
        """Return the plan as a sentence."""
        rows, columns = (1e6 * one for one in self.path_error_m)
        return (
            f"object of {1e3 * self.speed_m_s:.3g} mm/s: {self.frames} frames of {self.exposure_s:.3g} s, added in groups of "
            f"{self.frames_per_group} along its path: error of the estimate {100 * self.error:.3g} % "
            f"({100 * self.error_unfollowed:.3g} % if they were not added), path within {rows:.2g} um along rows and "
            f"{columns:.2g} um along columns per group"
            + (": no object can be detected, add light" if self.error > MAX_ERROR else "")
        )


def plan_motion(geometry: Any, lasts_s: float) -> MotionPlan:
    """Return the plan for a scene whose object moves while the laser is at rest.

    Args:
        lasts_s: duration of all frames together in seconds.

    Raises InputError for an object or laser that does not suit, for a scene without light, and for too short a time.
    """
    check_positive("--budget-s", lasts_s)
    motion, now_s = geometry.motion, geometry.camera.electronics.exposure_s
    way_m = max((float(np.linalg.norm(one.trajectory.displacement(now_s))) for one in geometry.movements), default=0.0)
    if geometry.spot.scan_step_m != 0.0 or np.hypot(*motion.object_way_m) <= 1e-6 * way_m:
        found = "no motion across the line of sight" if geometry.spot.scan_step_m == 0.0 else "a spot that moves between frames"
        raise InputError("--moving", "an object with a velocity, and scan_step 0 for the laser", found, "remove --moving")
    if any(one.trajectory.turns for one in geometry.movements):
        raise InputError("--moving", "an object that does not turn", "a rotation", "plan it without, and expose for less time")
    rest, way = predict(geometry.at_rest), np.array(motion.object_way_m) / now_s
    extent_m = np.array(geometry.hidden_object.extent_m)
    # What recedes by w spreads its speckle by w / z about the frame centre.
    spread_m = 0.5 * abs(geometry.receding_m) / geometry.distance_m * np.array(geometry.camera.extent_m)
    spread_turns = spread_m / (geometry.wavelength_m * geometry.distance_m)
    turns_per_s = float((np.abs(motion.turns_per_m) + spread_turns) @ extent_m) / now_s
    exposure_s = min(MAX_TURNS / max(turns_per_s, 1e-300), lasts_s / MIN_GROUPS)
    exposure_s = max(exposure_s, geometry.camera.electronics.gate)
    frames = int(lasts_s / exposure_s)
    if frames < MIN_GROUPS:
        raise InputError("--budget-s", f"at least {MIN_GROUPS * exposure_s:g} s", lasts_s, "raise the budget")
    sizes = [2**step for step in range(MAX_DOUBLINGS) if frames // 2**step >= MIN_GROUPS]
    frame, each = rest.at_exposure(exposure_s), motion.lasting(exposure_s / now_s)
    errors = {size: followed_error(frame, each, size, frames // size) for size in sizes}
    best = min(sizes, key=lambda size: errors[size])
    bound = path_bound_m(frame, best, geometry.travel)
    return MotionPlan(exposure_s, frames, best, errors[best], errors[1], bound, float(np.linalg.norm(way)))


def followed_error(frame: Prediction, motion: Motion, size: int, groups: int) -> float:
    """Return the relative error of r*r from groups of frames that follow the object.

    Args:
        frame: prediction for one frame of the object at rest.
        motion: motion in one frame.
        size, groups: number of frames in a group, and of groups.

    Raises InputError without light.
    """
    floor, signal, dof = _floor_over_peak(frame), frame.signal, frame.dof(groups)
    sums = float(signal.sum()), float((signal**2).sum()), signal.size
    # Floors add, and amplitudes of the speckle; a group of g frames has a g-th of the floor over peak, and a contrast of M.
    noise = estimate_error(*sums, floor / size / kept_by_group(motion, size), dof)
    # Groups whose illumination is alike repeat the noise of the speckle itself.
    repeated = groups / effective_groups(motion, size, groups) - 1.0
    return math.hypot(noise, estimate_error(*sums, 0.0, dof) * math.sqrt(repeated))


def _floor_over_peak(frame: Prediction) -> float:
    """Return the floor of one frame over the peak of r*r. Raises InputError without light."""
    floor = frame.floor_over_peak(1)
    if floor is None:
        raise InputError("scene", "light from the hidden object", "none", "raise power or albedo")
    return floor


def kept_by_group(motion: Motion, size: int) -> float:
    """Return the contrast M that the speckle of a group of frames keeps."""
    still = motion.lasting(size).of_followed_speckle
    return float(still.transfer(np.zeros(1), np.zeros(1))[0])


def effective_groups(motion: Motion, size: int, groups: int) -> float:
    """Return the number of independent groups of frames whose mean power spectrum varies as much as that of consecutive ones.

    Power spectra of groups correlate by the square of the correlation of their patterns, which is c over M.
    """
    count = max(1, math.ceil(min(motion.correlated_exposures / size, groups - 1)))
    apart = np.linspace(1.0, count, min(count, MAX_POINTS))
    alike = np.minimum(motion.correlation(size * apart) / kept_by_group(motion, size), 1.0) ** 2
    return groups / (1.0 + 2.0 * count * float(((1.0 - apart / groups) * alike).mean()))


def path_bound_m(frame: Prediction, size: int, travel: np.ndarray) -> tuple[float, float]:
    """Return the Cramer-Rao bound of the displacement of an object between a group of frames and its known pattern, along rows and columns.

    The pattern has power S and the frame noise of power b at each of its frequencies. The information about a displacement is the sum of
    (2 pi f)^2 S / b over all of them (Knapp and Carter, doi:10.1109/TASSP.1976.1162830). A lag stands for as many frequencies of the
    frame as it has patches.
    """
    floor, grid = _floor_over_peak(frame), frame.grid
    per_lag = math.prod(side / size for side, size in zip(grid.frame_shape, grid.patch_shape, strict=True))
    steps = 2.0 * np.pi * grid.lag_grid.steps.astype(float)
    turns = np.meshgrid(steps / grid.patch_shape[0], steps / grid.patch_shape[1], indexing="ij")
    information = (
        np.array([[float((one * other * frame.signal * size / floor).sum()) for other in turns] for one in turns]) * per_lag
    )
    to_metres = np.linalg.inv(travel)
    covariance = to_metres @ np.linalg.inv(information) @ to_metres.T
    return float(covariance[0, 0] ** 0.5), float(covariance[1, 1] ** 0.5)
