"""The camera, and the part of the virtual detector that it photographs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from correlograph.errors import InputError, check_positive
from radiometry.sensor.electronics import Electronics
from sim.trajectory import Trajectory


@dataclass(frozen=True)
class CameraView:
    """Camera and pixels. Lengths in metres, vectors in world axes (3,).

    Attributes:
        centre: point of the wall at the centre of the frame.
        right, down: steps on the wall between adjacent pixels, divided by `pixel_pitch_m`; longer than 1 if the camera sees the
            wall at an angle.
        pixel_pitch_m: pitch of the pixels on the wall, across the line of sight of the camera.
        frame_interval_s: time between the starts of two frames; the exposure if that is longer.
        polarisation_channels: number of frames recorded in one exposure, each in another polarisation.
        trajectory: motion of the camera in world axes, without rotation.

    Raises InputError for lengths that are not positive, and for a frame without pixels.
    """

    pupil_centre: np.ndarray
    centre: np.ndarray
    right: np.ndarray
    down: np.ndarray
    frame_shape: tuple[int, int]
    pixel_pitch_m: float
    pupil_diameter_m: float
    electronics: Electronics = field(default_factory=Electronics)
    frame_interval_s: float = 0.0
    polarisation_channels: int = 1
    trajectory: Trajectory = field(default_factory=Trajectory)

    def __post_init__(self) -> None:
        for name in ("pixel_pitch_m", "pupil_diameter_m", "pupil_distance_m"):
            check_positive(name, getattr(self, name))
        if min(self.frame_shape) < 1:
            raise InputError("frame_shape", "at least one row and one column", f"{self.frame_shape}", "enlarge the frame")

    @property
    def pupil_distance_m(self) -> float:
        """Distance from the wall to the pupil."""
        return float(np.linalg.norm(self.pupil_centre - self.centre))

    def view_shift(self, time_s: float) -> np.ndarray:
        """Return the displacement on the wall of the point at the frame centre, which moves with the camera, (3,)."""
        if not self.trajectory.moves:
            return np.zeros(3)
        moved, normal = self.trajectory.displacement(time_s), np.cross(self.right, self.down)
        axis = self.centre - self.pupil_centre
        return moved - axis * (moved @ normal) / (axis @ normal)

    @property
    def extent_m(self) -> tuple[float, float]:
        """Height and width of the frame, across the line of sight of the camera."""
        return self.frame_shape[0] * self.pixel_pitch_m, self.frame_shape[1] * self.pixel_pitch_m

    @property
    def footprint(self) -> float:
        """Area of a pixel on the wall in units of the squared pitch."""
        return abs(float(np.linalg.norm(np.cross(self.right, self.down))))
