"""Motion of a scene within the time that is foreseen, and the periods that it needs.

Both the light of the laser on the object and the speckle on the wall are computed on grids, and repeat after a period. Periods therefore
exceed the motion of the scene. A constant motion is foreseen for `FORESEEN_S`, a listed one as a whole, so that frames do not depend on
their number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from correlograph.errors import InputError
from sim.laser_speckle import along_axes, grain_m, lit_matrix, lit_place

if TYPE_CHECKING:
    from sim.geometry import Geometry

FORESEEN_S = 1.0
"""Time for which a constant motion is foreseen."""

MAX_WAYS = 4.0
"""Largest motion that is foreseen, in widths of the object and of the frame."""

LIT_WIDTHS = 1.25
"""Least period of the laser's light on the object, in widths of it."""

LIKE_GRAINS = 2.0
"""Grains of the laser's light by which an object moves until its speckle has changed: the correlation of an evenly lit spot is below 0.003
from there on."""


def lit_period_m(geometry: Geometry, width_m: float) -> float:
    """Return the period of the laser's light on an object of a width, in which no part of it meets the same light again."""
    return max(LIT_WIDTHS * width_m, min(_lit_way_m(geometry, geometry.moments()), MAX_WAYS * width_m) + _like_m(geometry))


def _lit_way_m(geometry: Geometry, times_s: np.ndarray) -> float:
    """Return the way of the fastest object through the laser's light between times."""
    ways = [lit_place(geometry, along_axes(geometry, one.trajectory.displacement(times_s))) for one in geometry.movements]
    return max((float(np.ptp(way, axis=0).max()) for way in ways), default=0.0)


def _like_m(geometry: Geometry) -> float:
    """Return the way of an object in which its light changes."""
    return LIKE_GRAINS * grain_m(geometry)


def speckle_ways(geometry: Geometry, times_s: np.ndarray) -> np.ndarray:
    """Return by how many pixels along rows and columns the speckle on the wall moves within the frame between times, (2,): with the camera,
    and with each object as long as it stays in the same light."""
    camera, ways = geometry.camera, [np.zeros(2)]
    like = _like_m(geometry) / max(float(np.linalg.svd(lit_matrix(geometry)[:, :2])[1].min()), 1e-3)
    for one in geometry.movements:
        way = np.ptp(geometry.hidden_object.axes.coordinates(one.trajectory.displacement(times_s)), axis=0)
        ways.append(np.abs(geometry.travel) @ np.minimum(way, like))
    view = np.stack([camera.view_shift(float(time)) for time in times_s]) @ np.stack([camera.down, camera.right], 1)
    return np.max(ways, axis=0) + np.ptp(view, axis=0) / camera.pixel_pitch_m


def speckle_travels(geometry: Geometry) -> bool:
    """Return whether the speckle moves by more than a grain within the time that is foreseen, or an object turns."""
    if any(one.trajectory.turns for one in geometry.movements):
        return True
    times = geometry.moments()
    along = [one.trajectory.displacement(times) @ geometry.hidden_object.line_of_sight for one in geometry.movements]
    # What recedes by w spreads its speckle by w / z about the frame centre.
    spread = max((float(np.ptp(way)) for way in along), default=0.0) / geometry.distance_m
    ways = speckle_ways(geometry, times) + 0.5 * spread * np.array(geometry.camera.frame_shape)
    return bool((ways > np.array(geometry.grain_pixels)).any())


def check_foreseen(geometry: Geometry, time_s: float) -> None:
    """Raise InputError if light or speckle would repeat because of the motion until a time."""
    times = geometry.moments()
    times = np.append(times[times < time_s], time_s)
    remedy = (
        f"render fewer frames, or slow it down; a constant motion is foreseen for {FORESEEN_S:g} s, a listed one as a whole"
    )
    lit = _lit_way_m(geometry, times)
    most = lit_period_m(geometry, max(geometry.hidden_object.extent_m)) - _like_m(geometry)
    if lit > most * (1.0 + 1e-9):
        raise InputError("motion", f"an object that moves by {most:.3g} m at most", f"{lit:.3g} m until {time_s:.3g} s", remedy)
    ways, spare = speckle_ways(geometry, times), np.subtract(geometry.period_shape, geometry.canvas_shape)
    if (ways > spare + 1e-6).any():
        expected = "speckle that moves by {} rows and {} columns at most".format(*spare)
        raise InputError("motion", expected, "{:.0f} and {:.0f} until {:.3g} s".format(*ways, time_s), remedy)
