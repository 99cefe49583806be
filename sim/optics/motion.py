"""Motion during and between exposures: a spot that moves over the wall, and an object that moves.

A frame is the mean intensity of sub-exposures, between which the speckle moves by a small fraction of a grain. An object
displaced by u across the line of sight is illuminated by other grains, and its speckle moves over the wall by u (1 + z /
d1). Both effects result from the phases of its scatterers. `radiometry/motion.py` gives the remaining speckle in closed
form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from correlograph.errors import InputError
from sim.geometry import Geometry
from sim.optics.object_samples import ObjectSamples

STEPS_PER_GRAIN = 6
"""Minimum number of sub-exposures per grain of motion."""

MAX_STEPS = 512
_SHARES = np.linspace(0.0, 1.0, 129)


@dataclass(frozen=True)
class Pose:
    """Positions of spot and object in one sub-exposure.

    Attributes:
        spot_m: displacement of the spot on the wall.
        object_m: displacement of the object along its axes (rows, columns).
    """

    spot_m: float = 0.0
    object_m: tuple[float, float] = (0.0, 0.0)


def poses(geometry: Geometry, number: int, count: int, *, moving: bool) -> list[Pose]:
    """Return the pose of spot and object at the middle of each of `count` sub-exposures.

    Args:
        moving: whether anything moves. A single sub-exposure omits the blur of a motion that is small in one frame, but not the
            displacement between frames.
    """
    exposure_s, interval_s = geometry.camera.electronics.exposure_s, geometry.camera.frame_interval_s
    begin_s = number * max(interval_s, exposure_s)
    speed = geometry.object_speed_m_s
    scanned = number * (geometry.spot.scan_step_m or 0.0)
    times = (np.arange(count) + 0.5) / count * exposure_s
    return [
        Pose(scanned + geometry.spot.scan_speed_m_s * float(time), tuple(float(part * (begin_s + time)) for part in speed))
        if moving
        else Pose(scanned)
        for time in times
    ]


def sub_exposures(geometry: Geometry, samples: ObjectSamples, tolerance: float) -> int:
    """Return the number of sub-exposures for which the variance of the speckle is accurate to the tolerance.

    Each sub-exposure is simulated without motion blur, so too few of them give too much variance. Raises InputError if the
    speckle moves by so many grains that hardly any contrast would remain.
    """
    if len(samples.amplitude) == 0:
        return 1
    grains = _grains(geometry)
    count = max(1, math.ceil(STEPS_PER_GRAIN * grains))
    if count > MAX_STEPS:
        raise InputError(
            "motion",
            f"at most {MAX_STEPS / STEPS_PER_GRAIN:.0f} grains in an exposure",
            f"{grains:.3g}",
            "shorten the exposure; the speckle would be gone",
        )
    likeness, exact = _likeness(geometry, samples), 1.0 - variance_lost_to_motion(geometry, samples)

    def left(count: int) -> float:
        apart = np.arange(1, count)
        return (1.0 + 2.0 * ((1.0 - apart / count) * np.interp(apart / count, _SHARES, likeness)).sum()) / count

    while count < MAX_STEPS and left(count) > (1.0 + tolerance) * exact:
        count = min(MAX_STEPS, math.ceil(1.2 * count))
    return count


def variance_lost_to_motion(geometry: Geometry, samples: ObjectSamples) -> float:
    """Return 1 - contrast^2 of the speckle: the fraction of its variance that is lost to motion during the exposure."""
    if not geometry.motion.moves or len(samples.amplitude) == 0:
        return 0.0
    return float(1.0 - 2.0 * np.trapezoid((1.0 - _SHARES) * _likeness(geometry, samples), _SHARES))


def _likeness(geometry: Geometry, samples: ObjectSamples) -> np.ndarray:
    """Return `correlation` after each fraction of the exposure in `_SHARES`."""
    return np.array([correlation(geometry, samples, share * geometry.camera.electronics.exposure_s) for share in _SHARES])


def correlation(geometry: Geometry, samples: ObjectSamples, seconds: float) -> float:
    """Return the correlation of the speckle intensity after a time: the product of three factors, for the overlap
    of the spots, for the object's motion through the illumination grains, and for the motion of the speckle over the wall."""
    motion, share = geometry.motion, seconds / geometry.camera.electronics.exposure_s
    power = samples.amplitude.astype(np.float64) ** 2
    waves = motion.waves(*samples.coordinates_m.T) * share
    travelled = abs((power * np.exp(2j * np.pi * waves)).sum()) / power.sum()
    return float(motion.correlation(share) * travelled**2)


def travel_phase(geometry: Geometry, coordinates_m: np.ndarray, pose: Pose) -> np.ndarray:
    """Return the phase in cycles, (n,), that an object displacement u adds to samples at coordinates x, (n, 2):
    x.u (1 / d1 + 1 / z) / lambda."""
    return coordinates_m @ np.array(pose.object_m) * geometry.motion.fringes_per_m2


def _grains(geometry: Geometry) -> float:
    """Return the largest motion in one exposure: of wall speckle or object in grains, of the spot in diameters."""
    motion = geometry.motion
    way = math.hypot(*motion.object_way_m)
    on_wall = way * motion.fringes_per_m2 * max(geometry.hidden_object.extent_m)
    return max(on_wall, way / motion.grain_m, motion.spot_way)
