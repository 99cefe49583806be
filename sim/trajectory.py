"""Rigid motion of a hidden object or of the camera over time: a constant velocity, and positions at given times.

Mitsuba 3 has no animated transforms, so a scene gives motion as parameters of `phase_screen` and `speckle_camera`, or in a file.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation, Slerp

from correlograph.errors import SI_MAX, InputError

COLUMNS = ("time_s", "x_m", "y_m", "z_m")
TURNS = ("rx_deg", "ry_deg", "rz_deg")
MAX_ROWS = 100_000
MAX_TURN_DEG = 1e6


@dataclass(frozen=True)
class Trajectory:
    """Displacement and rotation over time, in world axes, from the place of the scene file.

    Attributes:
        velocity_m_s: constant velocity, (3,).
        turn_deg_s: constant rate of rotation, a vector along its axis, (3,).
        times_s: times (n,) of the positions below, ascending; empty without any. Between them, displacements are interpolated linearly
            and rotations along the shortest way; before and after, the first and the last remain.
        displacement_m: displacements at these times, (n, 3).
        rotation_deg: rotation vectors at these times, (n, 3).
    """

    velocity_m_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    turn_deg_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    times_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    displacement_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    rotation_deg: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def moves(self) -> bool:
        return bool(np.any(self.velocity_m_s)) or bool(np.any(self.displacement_m)) or self.turns

    @property
    def turns(self) -> bool:
        return bool(np.any(self.turn_deg_s)) or bool(np.any(self.rotation_deg))

    def displacement(self, time_s: float | np.ndarray) -> np.ndarray:
        """Return the displacement at times (...), (..., 3)."""
        time = np.asarray(time_s, np.float64)[..., None]
        if len(self.times_s) == 0:
            return self.velocity_m_s * time
        listed = [np.interp(time_s, self.times_s, self.displacement_m[:, axis]) for axis in range(3)]
        return self.velocity_m_s * time + np.stack(listed, -1)

    def rotation(self, time_s: float | np.ndarray) -> Rotation:
        """Return the rotation at one time or at several (n,): that of the list, then the constant one."""
        constant = Rotation.from_rotvec(np.asarray(time_s, np.float64)[..., None] * np.radians(self.turn_deg_s))
        if len(self.times_s) == 0:
            return constant
        listed = Rotation.from_rotvec(np.radians(self.rotation_deg))
        if len(self.times_s) == 1:
            return constant * listed[0]
        return constant * Slerp(self.times_s, listed)(np.clip(time_s, self.times_s[0], self.times_s[-1]))

    def moments(self, duration_s: float) -> np.ndarray:
        """Return times that show every part of the motion: those of the list, and fractions of a duration."""
        return np.union1d(self.times_s, np.linspace(0.0, duration_s, 9))

    def matches(self, other: Trajectory) -> bool:
        """Return whether both describe the same motion."""
        return all(np.array_equal(mine, theirs) for mine, theirs in zip(vars(self).values(), vars(other).values(), strict=True))


def check_speed(name: str, speed_m_s: float) -> None:
    """Raise InputError for a speed that is not below that of light."""
    if speed_m_s >= speed_of_light:
        raise InputError(
            name, f"speeds below that of light, {speed_of_light:.3g} m/s", f"{speed_m_s:.3g}", "correct the motion"
        )


def read_trajectory(file: str | Path, name: str) -> Trajectory:
    """Read a CSV file with the columns time_s, x_m, y_m, z_m and, for rotations, rx_deg, ry_deg, rz_deg.

    Args:
        name: parameter that an error names.

    Raises InputError for a file that is missing or malformed, for times that do not ascend, and for speeds beyond that of light.
    """
    expected = f"a CSV file with the columns {', '.join(COLUMNS)} and, if it turns, {', '.join(TURNS)}"
    try:
        with open(file, newline="", encoding="utf-8-sig") as opened:
            header, *rows = csv.reader(opened)
            names = tuple(one.strip() for one in header)
            if names not in (COLUMNS, COLUMNS + TURNS) or not 1 <= len(rows) <= MAX_ROWS:
                raise ValueError(f"columns {', '.join(names)} and {len(rows)} rows")
            values = np.array([[float(cell) for cell in row] for row in rows if row])
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(name, expected, f"{file} ({error})", "write one row of numbers for each time") from None
    if (
        values.ndim != 2
        or values.shape[1] != len(names)
        or not np.isfinite(values).all()
        or np.abs(values[:, :4]).max() > SI_MAX
    ):
        raise InputError(name, f"finite numbers in every column, up to {SI_MAX:g}", str(file), "remove or complete such rows")
    if (falls := np.diff(values[:, 0]) <= 0.0).any():
        found = f"{values[int(np.argmax(falls)) + 1, 0]:g} s after {values[int(np.argmax(falls)), 0]:g} s in {file}"
        raise InputError(name, "times that ascend", found, "sort its rows by time, and remove repeated times")
    speeds = np.linalg.norm(np.diff(values[:, 1:4], axis=0), axis=1) / np.diff(values[:, 0])
    check_speed(name, speeds.max(initial=0.0))
    turns = values[:, 4:] if len(names) > len(COLUMNS) else np.zeros((len(values), 3))
    if np.abs(turns).max() > MAX_TURN_DEG:
        raise InputError(
            name, f"rotation vectors of at most {MAX_TURN_DEG:g} degrees", str(file), "give more rows, or angular_velocity"
        )
    # Vectors of at most half a turn are a usual notation, which jumps; longer ones count turns, of which the shortest way shows none.
    if np.linalg.norm(turns, axis=1).max() > 180.0 < np.linalg.norm(np.diff(turns, axis=0), axis=1).max(initial=0.0):
        raise InputError(name, "at most half a turn from row to row", str(file), "give more rows, or angular_velocity")
    return Trajectory(times_s=values[:, 0], displacement_m=values[:, 1:4], rotation_deg=turns)
