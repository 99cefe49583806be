"""Motion while the shutter is open and from frame to frame: a spot that travels over the wall, an object that moves.

A frame is the mean intensity of sub-exposures close enough together to share their grains. An object displaced by u across the
line of sight meets other grains of its illumination, and its speckle travels over the wall by u (1 + z / d1); both follow from
the phases of its scatterers (Goodman, Speckle Phenomena in Optics, section 5.7). With the speckle's autocorrelation |gamma|^2
over the way of one exposure, the contrast squared is 2 int_0^1 (1 - t) |gamma(t)|^2 dt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from radiometry.errors import InputError
from sim.geometry import Geometry
from sim.object_samples import ObjectSamples

STEPS_PER_GRAIN = 6
MOST_STEPS = 512


@dataclass(frozen=True)
class Pose:
    """Where spot and object stand in one sub-exposure.

    Attributes:
        spot_m: way of the spot over the wall.
        object_m: displacement of the object along its axes (down, right).
    """

    spot_m: float = 0.0
    object_m: tuple[float, float] = (0.0, 0.0)


def poses(geometry: Geometry, samples: ObjectSamples, number: int, *, moving: bool) -> list[Pose]:
    """Sub-exposures of a frame; a single one where nothing moves while the shutter is open."""
    exposure_s, interval_s = geometry.electronics.exposure_s, geometry.frame_interval_s
    begin_s = number * max(interval_s, exposure_s)
    speed = _object_speed(geometry)
    scanned = number * (geometry.spot.scan_step_m or 0.0)
    count = steps(geometry, samples) if moving else 1
    times = (np.arange(count) + 0.5) / count * exposure_s
    return [Pose(scanned + geometry.spot.scan_speed_m_s * float(time), tuple(float(part * (begin_s + time)) for part in speed))
            if moving else Pose(scanned) for time in times]


def steps(geometry: Geometry, samples: ObjectSamples) -> int:
    """Sub-exposures that follow the motion of one exposure. InputError where no speckle would be left."""
    grains = _grains(geometry)
    count = max(1, math.ceil(STEPS_PER_GRAIN * grains)) if len(samples.amplitude) else 1
    if count > MOST_STEPS:
        raise InputError("motion", f"at most {MOST_STEPS / STEPS_PER_GRAIN:.0f} grains in an exposure", f"{grains:.3g}",
                         "shorten the exposure; the speckle would be gone")
    return count


def lost_variance(geometry: Geometry, samples: ObjectSamples) -> float:
    """1 - contrast^2 of the speckle: the share of its variance that motion during the exposure takes."""
    if not is_moving(geometry) or len(samples.amplitude) == 0:
        return 0.0
    share = (np.arange(64) + 0.5) / 64
    kept = np.array([correlation(geometry, samples, part * geometry.electronics.exposure_s) for part in share])
    return float(1.0 - 2.0 * np.mean((1.0 - share) * kept))


def correlation(geometry: Geometry, samples: ObjectSamples, seconds: float) -> float:
    """Correlation of the speckle's intensity with that so much later: of spots that overlap, of illumination grains that the
    object has left, and of grains that travel over the wall."""
    reduced = min(geometry.spot.scan_speed_m_s * seconds / geometry.spot.diameter_m, 1.0)
    overlap = 2.0 / np.pi * (np.arccos(reduced) - reduced * np.sqrt(1.0 - reduced**2))
    speed = _object_speed(geometry)
    shift = np.array(speed) * seconds
    power = samples.amplitude.astype(np.float64) ** 2
    waves = samples.coordinates_m @ shift * _bending(geometry) / geometry.wavelength_m
    travelled = abs((power * np.exp(2j * np.pi * waves)).sum()) / power.sum()
    return float((overlap * travelled * _left(geometry, float(np.linalg.norm(shift)))) ** 2)


def is_moving(geometry: Geometry) -> bool:
    return bool(geometry.spot.scan_speed_m_s or np.any(geometry.object_velocity_m_s))


def travel_phase(geometry: Geometry, coordinates_m: np.ndarray, pose: Pose) -> np.ndarray:
    """Turns (n,) by which a displacement advances samples at coordinates (n, 2): x.u (1 / d1 + 1 / z) / lambda."""
    return coordinates_m @ np.array(pose.object_m) * _bending(geometry) / geometry.wavelength_m


def _bending(geometry: Geometry) -> float:
    return 1.0 / geometry.source_distance_m + 1.0 / geometry.distance_m


def _left(geometry: Geometry, shift_m: float) -> float:
    """Correlation of the illumination's field a shift apart: 2 J1(v) / v of a uniform disc (Goodman, Eq. 4-31)."""
    from scipy.special import j1

    argument = np.pi * geometry.spot.diameter_m * shift_m / (geometry.wavelength_m * geometry.source_distance_m)
    return float(abs(2.0 * j1(argument) / argument)) if argument > 1e-6 else 1.0


def _object_speed(geometry: Geometry) -> tuple[float, float]:
    """Across the line of sight along the object's axes (down, right), in m/s."""
    down, right = geometry.hidden_object.axes.coordinates(geometry.object_velocity_m_s)
    return float(down), float(right)


def _grains(geometry: Geometry) -> float:
    """Grains, of whichever kind is finest, that pass by in one exposure."""
    way = float(np.linalg.norm(_object_speed(geometry))) * geometry.electronics.exposure_s
    on_wall = way * _bending(geometry) * max(geometry.hidden_object.extent_m) / geometry.wavelength_m
    on_object = way * geometry.spot.diameter_m / (geometry.wavelength_m * geometry.source_distance_m)
    return max(on_wall, on_object, geometry.spot.scan_speed_m_s * geometry.electronics.exposure_s / geometry.spot.diameter_m)
