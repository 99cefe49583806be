"""Parameters of a motion, which `phase_screen` and `speckle_camera` share."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np

from correlograph.errors import InputError
from sim.trajectory import Trajectory, check_speed, read_trajectory

MOTION = ("velocity", "angular_velocity", "trajectory")

MAX_TURN_DEG_S = 1e9
"""Maximum rate of rotation; faster angles lose their digits."""


def read_motion(plugin: str, props: mi.Properties) -> Trajectory:
    """Return the motion that a plugin's parameters describe. Raises InputError for numbers that are not finite, for speeds beyond that
    of light, and for a file that cannot be read."""
    listed = Trajectory()
    if "trajectory" in props:
        listed = read_trajectory(str(mi.file_resolver().resolve(str(props["trajectory"]))), f"{plugin}.trajectory")
    velocity, turn = (_vector(plugin, name, props) for name in MOTION[:2])
    if np.abs(turn).max() > MAX_TURN_DEG_S:
        raise InputError(
            f"{plugin}.angular_velocity", f"at most {MAX_TURN_DEG_S:g} degrees/s", turn.tolist(), "correct the value"
        )
    with np.errstate(over="ignore"):
        check_speed(f"{plugin}.velocity", float(np.linalg.norm(velocity)))
    return replace(listed, velocity_m_s=velocity, turn_deg_s=turn)


def _vector(plugin: str, name: str, props: mi.Properties) -> np.ndarray:
    value = np.asarray(props.get(name, mi.ScalarVector3f(0.0)), np.float64).reshape(-1)
    if value.shape != (3,) or not np.isfinite(value).all():
        raise InputError(f"{plugin}.{name}", "three finite numbers", value.tolist(), "correct the value")
    return value
