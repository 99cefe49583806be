"""Footprint of a camera at any angle: the parallelogram of a pixel on the wall, and the lags that it resolves on the object.

A camera at an angle to the wall normal spreads each pixel over a parallelogram, longer by 1 / cos. Neighbouring pixels along a row
are `right` apart, along a column `down`, both in units of the camera pitch. As seen from the object, fringes of frequency
x / (lambda z) across the line of sight advance by x.right / (lambda z) between adjacent pixels. The lags of a patch therefore lie
on the lattice dual to the steps across the line of sight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

GRAZING = 0.05
"""Minimum cosine between camera and wall, or wall and object, of a footprint that can be modelled (87 degrees)."""


def pixel_steps(axis: np.ndarray, up: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps on the wall between adjacent pixels (right, down), per metre of the camera pitch; (3,) each.

    Args:
        axis, up: unit vectors of the camera. normal: normal of the wall.
    """
    right = np.cross(axis, up)
    right /= np.linalg.norm(right)
    down = np.cross(axis, right)
    return (right - axis * (right @ normal) / (axis @ normal), down - axis * (down @ normal) / (axis @ normal))


@dataclass(frozen=True)
class LagAxes:
    """Lattice of lags on the object, across the line of sight.

    Attributes:
        down, right: unit vectors of the rows and columns of a lag grid.
        stretch: (rows, columns): metres on the object per lambda z / (pixels x pitch); 1 if the axis of the camera and the
            normal of the wall are parallel to the line of sight.
        step: steps on the wall across the line of sight, (down, right), per metre of the camera pitch.
    """

    down: np.ndarray
    right: np.ndarray
    stretch: tuple[float, float]
    step: tuple[np.ndarray, np.ndarray]

    @property
    def cell(self) -> float:
        """Area of a cell divided by the product of its side lengths: the sine of the angle between the axes."""
        return float(np.linalg.norm(np.cross(self.down, self.right)))

    def coordinates(self, position: np.ndarray) -> np.ndarray:
        """Return coordinates (..., 2) along `down` and `right` of positions (..., 3), in metres."""
        return np.stack([position @ step * stretch for step, stretch in zip(self.step, self.stretch, strict=True)], -1)


def lag_axes(right: np.ndarray, down: np.ndarray, line: np.ndarray) -> LagAxes:
    """Return the directions on the object, perpendicular to `line`, in which the lags of rows and of columns are measured.

    Args:
        right, down: pixel steps on the wall. line: unit vector from the wall to the object.
    """
    steps = [step - line * (step @ line) for step in (down, right)]
    gram = np.array([[a @ b for b in steps] for a in steps])
    dual = np.linalg.inv(gram) @ np.array(steps)
    length = np.linalg.norm(dual, axis=1)
    return LagAxes(dual[0] / length[0], dual[1] / length[1], (float(length[0]), float(length[1])), (steps[0], steps[1]))
