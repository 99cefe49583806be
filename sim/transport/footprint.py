"""What a camera at any angle sees of the wall: the footprint of a pixel, and the lags that it resolves on the object.

A camera turned by an angle away from the wall's normal spreads each pixel over a parallelogram of the wall, 1 / cos larger
along the turn. Neighbouring pixels along a row are `right` apart, along a column `down`, both in units of the camera's own
pitch. Seen from the object, fringes of frequency x / (lambda z) across the line of sight advance by x.right / (lambda z) from
one pixel to the next, so the lags of a patch lie on the lattice dual to the steps across the line of sight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

GRAZING = 0.05
"""Smallest cosine between camera and wall, or wall and object, at which a footprint is still modelled (87 degrees)."""


def pixel_steps(axis: np.ndarray, up: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps on the wall from a pixel to the next (right, down), per metre of the camera's pitch; (3,) each.

    Args:
        axis, up: of the camera, unit vectors. normal: of the wall.
    """
    right = np.cross(axis, up)
    right /= np.linalg.norm(right)
    down = np.cross(axis, right)
    return (right - axis * (right @ normal) / (axis @ normal), down - axis * (down @ normal) / (axis @ normal))


@dataclass(frozen=True)
class LagAxes:
    """The lattice of lags on the object, across the line of sight.

    Attributes:
        down, right: unit vectors along which rows and columns of a lag grid run.
        stretch: (rows, columns): metres on the object for each lambda z / (pixels x pitch), 1 for a camera and a wall that
            face the light.
        step: the wall's steps across the line of sight, (down, right), per metre of the camera's pitch.
    """

    down: np.ndarray
    right: np.ndarray
    stretch: tuple[float, float]
    step: tuple[np.ndarray, np.ndarray]

    @property
    def cell(self) -> float:
        """Area of a cell over the product of its sides."""
        return float(np.linalg.norm(np.cross(self.down, self.right)))

    def coordinates(self, position: np.ndarray) -> np.ndarray:
        """Coordinates (..., 2) along `down` and `right` of positions (..., 3), in metres."""
        return np.stack([position @ step * stretch for step, stretch in zip(self.step, self.stretch, strict=True)], -1)


def lag_axes(right: np.ndarray, down: np.ndarray, line: np.ndarray) -> LagAxes:
    """Axes of the lags on an object seen along `line` (unit) by a wall whose pixels step by `right` and `down`."""
    steps = [step - line * (step @ line) for step in (down, right)]
    gram = np.array([[a @ b for b in steps] for a in steps])
    dual = np.linalg.inv(gram) @ np.array(steps)
    length = np.linalg.norm(dual, axis=1)
    return LagAxes(dual[0] / length[0], dual[1] / length[1], (float(length[0]), float(length[1])), (steps[0], steps[1]))
