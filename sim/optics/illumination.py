"""Field on the hidden object: a laser spot on the rough virtual source, propagated to the object."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from radiometry.motion import airy, disc_overlap
from sim.geometry import Geometry
from sim.optics.motion import Pose

Streams = Callable[[int], np.random.Generator]

_MIN_SPOT_SAMPLES = 32
"""Source samples across the spot at least, so that its speckle is Gaussian."""


def grain_m(geometry: Geometry) -> float:
    """Size of a speckle grain on the object, lambda d1 / D (van Cittert-Zernike)."""
    return geometry.wavelength_m * geometry.source_distance_m / geometry.spot.diameter_m


def overlap(geometry: Geometry) -> float:
    """Share of the spot that one frame has in common with the next; 0 where each frame has a spot of its own.

    The fields of the two frames correlate by as much, their intensities by its square.
    """
    if geometry.spot.scan_step_m is None or geometry.spot.scan_step_m >= geometry.spot.diameter_m:
        return 0.0
    return float(disc_overlap(geometry.spot.scan_step_m / geometry.spot.diameter_m))


def illuminate(
    geometry: Geometry, grid: tuple[int, int], streams: Streams, number: int, *, grain: bool = True, pose: Pose | None = None
) -> np.ndarray:
    """Complex field on the object, mean intensity 1 under a rough wall, at the samples of `Geometry.object_pitch_m`.

    The wall's heights turn the disc of light into a field of random phases 4 pi h / lambda (normal
    incidence); each source sample is larger than the heights' correlation length, so phases are
    independent. Fraunhofer from source to object: the quadratic phases that it drops are lost in
    the random phases of both rough surfaces. What a smooth wall does not scatter is its
    specular component.

    Args:
        grid: samples (rows, columns) on the object.
        streams: streams(frame) -> random generator of that frame's screens.
        number: the frame's. Spots that overlap lie side by side on one wall and light one object; others share nothing.
        grain: whether the spot's own speckle lights the object; evenly lit if not.
        pose: of spot and object; where the frame's number puts them if None.

    Returns:
        complex64 (rows, columns); times the object's own delta-correlated random phase.
    """
    pitch = geometry.object_pitch_m
    pose = pose or Pose(number * (geometry.spot.scan_step_m or 0.0))
    sharing = overlap(geometry) > 0.0
    # One wall and one object for all frames, or for all of one frame.
    shared = sharing or geometry.spot.scan_speed_m_s > 0.0 or any(pose.object_m)
    rng = streams(0 if sharing else number)
    own_phase = np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, grid).astype(np.float32))
    if not grain:
        return own_phase
    if grain_m(geometry) < 0.5 * min(pitch) and not shared and specular_share(geometry) < 1e-12:
        # No two samples share a grain: independent circular Gaussians, whatever the spot's shape.
        gaussian = rng.standard_normal((2, *grid), np.float32) * np.float32(np.sqrt(0.5))
        return gaussian[0] + 1j * gaussian[1]
    reach = 1.25 * max(n * step for n, step in zip(grid, pitch, strict=True))
    wanted = geometry.wavelength_m * geometry.source_distance_m / reach
    across = max(_MIN_SPOT_SAMPLES, int(np.ceil(geometry.spot.diameter_m / wanted)))
    step = geometry.spot.diameter_m / across
    position = (np.arange(across) - 0.5 * (across - 1)) * step
    spot_m = pose.spot_m if sharing else pose.spot_m - number * (geometry.spot.scan_step_m or 0.0)
    first = math.floor(spot_m / step) if shared else 0
    if shared:  # one column more, over part of which the spot has moved
        along = position[0] + np.arange(first, first + across + 1) * step
        disc = np.hypot(position[:, None], along[None, :] - spot_m) <= 0.5 * geometry.spot.diameter_m
        heights = _strip(rng, across, first, across + 1)
    else:
        along = position
        disc = np.hypot(position[:, None], along[None, :]) <= 0.5 * geometry.spot.diameter_m
        heights = rng.standard_normal((across, across))
    specular = np.sqrt(specular_share(geometry))
    phase = 4.0 * np.pi / geometry.wavelength_m * geometry.spot.height_rms_m * heights
    source = (disc * (np.exp(1j * phase) - specular)).astype(np.complex64)
    to_rows = _fourier_kernel(grid[0], pitch[0], position, geometry, pose.object_m[0])
    to_columns = _fourier_kernel(grid[1], pitch[1], along, geometry, pose.object_m[1])
    scattered = (to_rows @ source @ to_columns.T) / np.float32(np.sqrt(disc.sum()))
    return (scattered + specular_field(geometry, grid)) * own_phase


def specular_share(geometry: Geometry) -> float:
    """Share of the light that a smooth wall does not scatter, exp(-(4 pi s / lambda)^2) at normal incidence (Beckmann)."""
    return float(np.exp(-((4.0 * np.pi * geometry.spot.height_rms_m / geometry.wavelength_m) ** 2)))


def specular_field(geometry: Geometry, grid: tuple[int, int]) -> np.ndarray | float:
    """Field of the spot's mirror image on the object, in units of what a Lambertian wall scatters there; 0 for a rough wall.

    The spot's Airy pattern around the mirror direction (Goodman, Introduction to Fourier Optics, Eq. 4-30): its
    irradiance P A / (lambda d1)^2 against the Lambertian P / (pi d1^2).
    """
    share = specular_share(geometry)
    if share < 1e-12:
        return 0.0
    spot, hidden = geometry.spot, geometry.hidden_object
    row, column = ((np.arange(n) - 0.5 * (n - 1)) * step for n, step in zip(grid, geometry.object_pitch_m, strict=True))
    way = hidden.centre - spot.centre + row[:, None, None] * hidden.axes.down + column[None, :, None] * hidden.axes.right
    missed = way / np.linalg.norm(way, axis=-1, keepdims=True) - spot.beam
    missed -= (missed @ spot.normal)[..., None] * spot.normal
    argument = np.pi * spot.diameter_m / geometry.wavelength_m * np.linalg.norm(missed, axis=-1)
    gain = np.pi * (0.25 * np.pi * spot.diameter_m**2) / geometry.wavelength_m**2
    return (np.sqrt(share * gain) * airy(argument)).astype(np.complex64)


def _strip(rng: np.random.Generator, across: int, first: int, count: int) -> np.ndarray:
    """Columns `first` on of an endless strip of heights, each from a seed of its own; (across, count)."""
    seed = int(rng.integers(2**63))
    columns = range(first, first + count)
    return np.stack([np.random.default_rng([seed, column]).standard_normal(across) for column in columns], 1)


def _fourier_kernel(
    samples: int, pitch: float, source_position: np.ndarray, geometry: Geometry, displaced_m: float
) -> np.ndarray:
    """exp(-2 pi i x s / (lambda d1)) along one axis, complex64 (samples, sources)."""
    position = (np.arange(samples) - 0.5 * (samples - 1)) * pitch + displaced_m
    turns = np.outer(position, source_position) / (geometry.wavelength_m * geometry.source_distance_m)
    return np.exp(-2j * np.pi * turns).astype(np.complex64)
