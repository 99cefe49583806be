"""Albedo of the virtual detector under each pixel, by one ray from the pupil to each."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from correlograph.errors import InputError
from sim.camera_view import CameraView

MAX_UNIFORM_VARIATION = 1e-6
"""Maximum relative variation of the albedo of a wall without texture."""


def detector_albedo(scene: mi.Scene, detector: mi.Shape, view: CameraView) -> np.ndarray:
    """Return the diffuse albedo of the wall at the centre of each pixel, float32 (H, W).

    Raises InputError if the camera does not see the front of the virtual detector in every pixel.
    """
    height, width = frame_shape = view.frame_shape
    index = dr.arange(mi.UInt, height * width)
    row, column = (
        (mi.Float(part) - 0.5 * (n - 1)) * view.pixel_pitch_m for part, n in ((index // width, height), (index % width, width))
    )
    to_centre = view.centre - view.pupil_centre
    way = mi.Vector3f(*to_centre.tolist()) + row * mi.Vector3f(*view.down.tolist()) + column * mi.Vector3f(*view.right.tolist())
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(*view.pupil_centre.tolist()), dr.normalize(way)))
    seen = hit.is_valid() & (hit.shape == mi.ShapePtr(detector)) & (dr.dot(hit.n, way) < 0.0)
    hidden = 1.0 - float(dr.count(seen)[0]) / math.prod(frame_shape)
    if hidden > 0.0:
        raise InputError(
            "virtual_detector",
            "its front in every pixel of the camera",
            f"{100 * hidden:.3g} % of them see something else or nothing; the pixels cover {_footprint(view)} of it",
            "check pixel_pitch, in metres on the sensor, and magnification, enlarge the wall, or move what stands before it",
        )
    return np.asarray(hit.bsdf().eval_diffuse_reflectance(hit)[0], np.float32).reshape(frame_shape)


def texture_of(albedo: np.ndarray) -> tuple[float, np.ndarray | None]:
    """Return the mean albedo and the relative albedo of each pixel; None if it is uniform."""
    mean = float(albedo.mean(dtype=np.float64))
    even = mean == 0.0 or float(np.ptp(albedo)) < MAX_UNIFORM_VARIATION * mean
    return mean, None if even else albedo / np.float32(mean)


def _footprint(view: CameraView) -> str:
    """Return width and height of the part of the wall that the camera sees, across its line of sight."""
    rows, columns = view.extent_m
    return f"{1e3 * columns:.4g} x {1e3 * rows:.4g} mm"
