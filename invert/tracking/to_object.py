"""From the displacement of the speckle on the wall to that of the object: a factor, and what the illumination adds to it.

The speckle of the illumination is a lens: it stretches, shears and turns the path of an object's speckle.

The illumination g of an object that moves by d becomes g (1 + i J / |g|^2) with J = Im(g* grad g) d. Where J rises or falls across the
object, the speckle on the wall moves by more or less than d (1 + z / d1). J has the mean 0, so that no frame tells by how much, but its
variance is known: the integral of its covariance over the object is C |d|^2, with C = pi for an evenly lit round spot of any size, because
smaller grains are steeper. The phase that grows across the object as J does has the slope

    q = M^-1 int w e J,    var q = C |d|^2 M^-1 (int w^2 e e^T) M^-1,    M = int w e e^T,

with the albedo w and the place e from its middle, and moves the speckle by z q / k. The illumination within the object stays the same
while the object moves by less than its strokes are wide, so that the path is stretched as a whole.
"""

from __future__ import annotations

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata
from invert.tracking.band import Band

ROUND_SPOT = np.pi
"""Integral of the covariance of J for an evenly lit round spot and a displacement of 1; half of it for a Gaussian one."""


def metres_per_pixel(camera: CameraMetadata, source_distance_m: float, source_angle_deg: tuple[float, float]) -> np.ndarray:
    """Return the displacement of the object per pixel of its speckle, (2, 2): the inverse of (1 + P z / d1) / pitch, where P keeps what
    lies across the light from the spot. Raises InputError without the metadata of the camera, and for angles beyond 80 degrees."""
    _, distance, pitches = _geometry(camera)
    if not np.abs(source_angle_deg).max() <= 80.0:
        raise InputError("source_angle_deg", "two angles of at most 80 degrees", source_angle_deg, "correct them")
    tangent = np.tan(np.radians(source_angle_deg))
    across = tangent / np.sqrt(1.0 + tangent @ tangent)
    travel = np.eye(2) + distance / source_distance_m * (np.eye(2) - np.outer(across, across))
    return np.linalg.inv(travel / np.array(pitches)[:, None])


def stretch_by_illumination(band: Band, camera: CameraMetadata, binning: int) -> np.ndarray:
    """Return the standard deviation of what the illumination adds to a displacement of the speckle, in pixels (rows, columns) per metre of
    the object's displacement, (2,).

    Args:
        binning: pixels of a frame per pixel of the band, along each axis.

    Raises InputError without the metadata of the camera.
    """
    wavelength, distance, pitches = _geometry(camera)
    per_pixel = np.prod(pitches) ** 0.5 / (wavelength * distance)  # cycles per metre of the object
    area = band.cells / np.prod(band.shape)
    return binning**2 * per_pixel * (ROUND_SPOT / area * band.inverse_spread.diagonal()) ** 0.5 / (2.0 * np.pi)


def slope_variance(albedo: np.ndarray, places_m: np.ndarray, cell_m2: float) -> np.ndarray:
    """Return var q / |d|^2, (2, 2), in (radians per metre of the object and per metre of its way)^2.

    Args:
        albedo: (n,), of cells of an area `cell_m2` at places_m (n, 2).
    """
    away = places_m - np.average(places_m, 0, albedo)
    weighted = albedo[:, None] * away
    inverse = np.linalg.inv(weighted.T @ away)
    return ROUND_SPOT / cell_m2 * inverse @ (weighted.T @ weighted) @ inverse


def _geometry(camera: CameraMetadata) -> tuple[float, float, tuple[float, float]]:
    if camera.lag_geometry is None:
        raise InputError("camera", "wavelength, pixel pitch and distance", "none", "give them with the frames")
    return camera.lag_geometry
