"""Motion during and between exposures: of the spot over the wall, of hidden objects, and of the camera.

A frame is the mean intensity of sub-exposures, between which the speckle moves by a small fraction of a grain. An object is a rigid set
of scatterers. When it has moved, each of them lies in other light of the laser's speckle, and the way from the spot by it to the wall has
another length. Both follow from its position. Displaced by u across the line of sight, an object moves its speckle by u (1 + z / d1);
displaced by w along it, away from the wall, it spreads its speckle by 1 + w / z about the frame centre; turned about the line of sight, it
turns its speckle. What lies across the ray from the spot crosses the laser's light (`sim/laser_speckle.py`). `radiometry/motion.py` gives
the remaining speckle of a uniform motion in closed form. The light of each scatterer is that at rest: shading, occlusion, and the depth of
the laser's speckle (8 lambda (d1 / D)^2) are taken as unchanged by the motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.chebyshev import chebpts1

from correlograph.errors import InputError
from radiometry.motion import airy, disc_overlap
from sim.geometry import Geometry
from sim.laser_speckle import along_axes, grain_m, lit_place
from sim.optics.object_samples import ObjectSamples
from sim.propagation.nufft import interpolation
from sim.propagation.sampling import Wall, path_difference

STEPS_PER_GRAIN = 6
"""Minimum number of sub-exposures per grain of motion."""

MAX_STEPS = 512

MIN_DISTANCE = 0.1
"""Least distance of a moving object from the virtual detector, as a fraction of that at rest."""

_SHARES = np.linspace(0.0, 1.0, 129)

MAX_BEATS = 5.0
"""Turns of the phase between two objects in an exposure up to which their beats are simulated; beyond, less than (1 / 5 pi)^2 is left."""

_NODES = 6
"""Chebyshev nodes along each side of the wall for the phase of a displaced object."""

_CHOSEN = 8192
"""Number of samples from which correlations are computed; more of them are drawn at random."""


@dataclass(frozen=True)
class Pose:
    """Spot and time of one sub-exposure.

    Attributes:
        spot_m: displacement of the spot on the wall.
        time_s: time since the first frame; None if nothing moves.
    """

    spot_m: float = 0.0
    time_s: float | None = None


@dataclass(frozen=True)
class Moved:
    """Samples of an object after a motion.

    Attributes:
        position_m: from the object's centre at rest, (n, 3).
        coordinates_m: along the axes of the object's grid and, from the place at rest, along the line of sight, (n, 3).
        shifts_m: displacement of each hidden object along these axes, (objects, 3); None if one of them leaves its grid.
        path_m: change of the length of the way from the spot to each sample, (n,).
        wall: pixels on the wall; a moving camera sees others.
        frame_path_m: change of the length of the way from each sample to the frame centre, (n,).
    """

    position_m: np.ndarray
    coordinates_m: np.ndarray
    shifts_m: np.ndarray | None
    path_m: np.ndarray
    wall: Wall
    frame_path_m: np.ndarray


def poses(geometry: Geometry, number: int, count: int, *, moving: bool) -> list[Pose]:
    """Return the pose of spot and objects at the middle of each of `count` sub-exposures.

    Args:
        moving: whether anything moves. A single sub-exposure omits the blur of a motion that is small in one frame, but not the
            displacement between frames.
    """
    exposure_s, begin_s = geometry.camera.electronics.exposure_s, geometry.exposure_time_s(number)
    scanned = number * (geometry.spot.scan_step_m or 0.0)
    times = (np.arange(count) + 0.5) / count * exposure_s
    return [
        Pose(scanned + geometry.spot.scan_speed_m_s * float(time), begin_s + float(time) if geometry.moves else None)
        if moving
        else Pose(scanned)
        for time in times
    ]


def move(geometry: Geometry, samples: ObjectSamples, time_s: float, chosen: slice | np.ndarray = slice(None)) -> Moved:
    """Return samples at a time; `chosen` selects some of them. Raises InputError for an object that has come too close to the wall."""
    rest, hidden = samples.position_m[chosen], geometry.hidden_object
    position = moved_positions(geometry, rest, samples.part[chosen], time_s)
    nearest = geometry.distance_m + float((position @ hidden.line_of_sight).min())
    if nearest < MIN_DISTANCE * geometry.distance_m:
        expected = f"an object {MIN_DISTANCE * geometry.distance_m:.3g} m or more from the virtual detector"
        raise InputError("motion", expected, f"{nearest:.3g} m after {time_s:.3g} s", "render fewer frames, or slow it down")
    ways = [along_axes(geometry, one.trajectory.displacement(time_s)) for one in geometry.movements] or [np.zeros(3)]
    view = geometry.camera.view_shift(time_s)
    wall = replace(samples.wall, centre_m=samples.wall.centre_m + view)
    spot = geometry.spot.centre - hidden.centre
    return Moved(
        position,
        np.pad(samples.coordinates_m[chosen], ((0, 0), (0, 1))) + along_axes(geometry, position - rest),
        np.array(ways) if geometry.moves_on_lattice else None,
        path_difference(spot, position) - path_difference(spot, rest),
        wall,
        path_difference(wall.centre_m, position) - path_difference(samples.wall.centre_m, rest),
    )


def moved_positions(geometry: Geometry, rest: np.ndarray, part: np.ndarray, time_s: float) -> np.ndarray:
    """Return where points of the hidden objects are at a time, (n, 3), relative to the centre of all at rest.

    Args:
        rest: their positions at rest, (n, 3).
        part: the hidden object of each, (n,).
    """
    position = rest.copy()
    for index, movement in enumerate(geometry.movements):
        mine, path = part == index, movement.trajectory
        centre = movement.centre - geometry.hidden_object.centre
        position[mine] = centre + path.rotation(time_s).apply(rest[mine] - centre) + path.displacement(time_s)
    return position


def tilt(geometry: Geometry, wall: Wall, part: int, time_s: float) -> np.ndarray:
    """Return the phase factor on the wall, complex64 (H, W), by which the field of a displaced object differs from that of its samples at
    their places on the grid; 1 at the frame centre. Only light of other objects shows it."""
    centre = geometry.movements[part].centre - geometry.hidden_object.centre
    moved = centre + geometry.movements[part].trajectory.displacement(time_s)
    # The change of the path is smooth, so that a few nodes give it everywhere.
    nodes = chebpts1(_NODES)
    at = [0.5 * (side - 1) * (1.0 + nodes) for side in wall.shape]
    pixels = wall.pixels(*np.meshgrid(*at, indexing="ij"))
    change = path_difference(pixels, moved) - path_difference(pixels, centre)
    change -= path_difference(wall.centre_m, moved) - path_difference(wall.centre_m, centre)
    down, across = (interpolation(_NODES, np.linspace(-1.0, 1.0, side)) for side in wall.shape)
    turns = (down @ (change / wall.wavelength_m) @ across.T).astype(np.float32)
    return np.exp(np.complex64(2j * np.pi) * turns)


def typical_positions(geometry: Geometry, samples: ObjectSamples) -> np.ndarray:
    """Return positions (n, 3) of the samples, each at one of several times of the motion, for the choice of a propagator."""
    if geometry.moves_on_lattice or len(samples.amplitude) == 0:
        return samples.position_m
    times = geometry.moments()
    turn, position = np.arange(len(samples.amplitude)) % len(times), samples.position_m.copy()
    for index, time in enumerate(times):
        position[turn == index] = move(geometry, samples, float(time), turn == index).position_m
    return position


def sub_exposures(geometry: Geometry, samples: ObjectSamples, tolerance: float) -> int:
    """Return the number of sub-exposures for which the variance of the speckle is accurate to the tolerance.

    Each sub-exposure is simulated without motion blur, so too few of them give too much variance. Raises InputError if the
    speckle moves by so many grains that hardly any contrast would remain.
    """
    if len(samples.amplitude) == 0:
        return 1
    grains = _grains(geometry, samples)
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
    """Return 1 - contrast^2 of the speckle: the fraction of its variance that is lost to motion during the exposure with the longest way,
    as if the motion in it were uniform."""
    if not (geometry.moves or geometry.motion.moves) or len(samples.amplitude) == 0:
        return 0.0
    return float(1.0 - 2.0 * np.trapezoid((1.0 - _SHARES) * _likeness(geometry, samples), _SHARES))


def _likeness(geometry: Geometry, samples: ObjectSamples) -> np.ndarray:
    """Return `correlation` after each fraction of the exposure in `_SHARES`."""
    exposure_s, begin_s = geometry.camera.electronics.exposure_s, geometry.busiest_time_s()
    return np.array([correlation(geometry, samples, share * exposure_s, begin_s) for share in _SHARES])


def correlation(geometry: Geometry, samples: ObjectSamples, seconds: float, begin_s: float = 0.0) -> float:
    """Return the correlation of the speckle intensity at the frame centre between a time and `seconds` later: the squared mean over the
    light of the samples of three factors, for the overlap of the spots, for the way of a sample through the illumination grains, and
    for the change of its path length.
    """
    chosen = _few(samples)
    power = samples.amplitude[chosen].astype(np.float64) ** 2
    before, after = (move(geometry, samples, time, chosen) for time in (begin_s, begin_s + seconds))
    path = (after.path_m + after.frame_path_m) - (before.path_m + before.frame_path_m)
    through = np.pi * _grains_crossed(geometry, before, after)
    field = power / power.sum() * airy(through) * np.exp(2j * np.pi / geometry.wavelength_m * (path - path.mean()))
    spot = disc_overlap(geometry.spot.scan_speed_m_s * seconds / geometry.spot.diameter_m)
    return float((spot * abs(field.sum())) ** 2)


def _grains_crossed(geometry: Geometry, before: Moved, after: Moved) -> np.ndarray:
    """Return the grains of the laser's speckle that each sample crosses between two times, (n,)."""
    return np.linalg.norm(lit_place(geometry, after.coordinates_m - before.coordinates_m), axis=1) / grain_m(geometry)


def _few(samples: ObjectSamples) -> slice | np.ndarray:
    count = len(samples.amplitude)
    return slice(None) if count <= _CHOSEN else np.sort(np.random.default_rng(0).choice(count, _CHOSEN, replace=False))


def beats_remain(geometry: Geometry, samples: ObjectSamples, *, static: bool) -> bool:
    """Return whether hidden objects that move differently still interfere in a frame: whether the paths by them change alike, up to
    `MAX_BEATS` wavelengths during the exposure. Beyond that their Doppler shifts differ, and their speckle adds in intensity.

    Args:
        static: whether light of things at rest interferes with the objects, too.
    """
    if not geometry.moves or len(samples.amplitude) == 0:
        return True
    begin_s, chosen = geometry.busiest_time_s(), _few(samples)
    times = (begin_s, begin_s + geometry.camera.electronics.exposure_s)
    before, after = (move(geometry, samples, time, chosen) for time in times)
    change, part = (after.path_m + after.frame_path_m) - (before.path_m + before.frame_path_m), samples.part[chosen]
    means = [change[part == index].mean() for index in np.unique(part)] + [0.0] * static
    return bool(np.ptp(means) <= MAX_BEATS * geometry.wavelength_m)


def _grains(geometry: Geometry, samples: ObjectSamples) -> float:
    """Return the largest motion of an object in one exposure: in grains of the speckle at the centre and the corners of the frame, in
    grains of the illumination, and in diameters of the spot; of all objects together if they interfere."""
    begin_s, exposure_s, chosen = geometry.busiest_time_s(), geometry.camera.electronics.exposure_s, _few(samples)
    height, width = samples.wall.shape
    rows, columns = np.array([0.5, 0.0, 0.0, 1.0, 1.0]) * height, np.array([0.5, 0.0, 1.0, 0.0, 1.0]) * width
    before = move(geometry, samples, begin_s, chosen)
    on_wall, through, part = 0.0, 0.0, samples.part[chosen]
    apart = not beats_remain(geometry, samples, static=False)
    together = [part == index for index in np.unique(part)] if apart else [np.ones(len(part), bool)]
    for time in begin_s + exposure_s * np.array([0.25, 0.5, 0.75, 1.0]):
        after = move(geometry, samples, float(time), chosen)
        through += float(_grains_crossed(geometry, before, after).max())
        ways = [
            path_difference(pixel, moved.position_m) + moved.path_m
            for moved in (before, after)
            for pixel in moved.wall.pixels(rows, columns)
        ]
        turns = (np.array(ways[5:]) - np.array(ways[:5])) / geometry.wavelength_m
        on_wall += max(float(np.ptp(turns[:, mine], axis=1).max()) for mine in together)
        before = after
    return max(geometry.motion.spot_way, on_wall, through)
