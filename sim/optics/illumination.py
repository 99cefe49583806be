"""Field on the hidden object: a laser spot on the rough virtual source, propagated to the object."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from radiometry.coherence import variance_lost_to_linewidth
from radiometry.motion import airy, disc_overlap
from sim.foreseen import lit_period_m
from sim.geometry import Geometry
from sim.laser_speckle import grain_m, lit_matrix

Streams = Callable[[int], np.random.Generator]

_MIN_SPOT_SAMPLES = 32
"""Minimum number of source samples across the spot, so that its speckle is Gaussian."""


@dataclass(frozen=True)
class Displaced:
    """Positions of the spot and of the samples of a moving object.

    Attributes:
        spot_m: displacement of the spot on the wall.
        place: row and column of each sample of a moving object on the grid at rest, (n,) each; None if nothing moves.
        coordinates_m: along the axes of the grid (rows, columns) and, from the place at rest, along the line of sight, (n, 3).
        shift_m: displacement along these axes that all samples share, (3,); None if they have no single one.
        reach_m: distance by which samples leave the grid at any time.
    """

    spot_m: float
    place: tuple[np.ndarray, np.ndarray] | None = None
    coordinates_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    shift_m: np.ndarray | None = None
    reach_m: float = 0.0


def lost_over_spot(geometry: Geometry) -> tuple[float, float]:
    """Return by how much the ways of the light to the object differ across the laser spot, in metres, and the part of the squared contrast
    that this takes at the linewidth of the laser.

    They rise linearly across the spot, by the components of beam and way to the object along the wall.
    """
    spot, to_object = geometry.spot, geometry.hidden_object.centre - geometry.spot.centre
    rise = spot.beam - to_object / np.linalg.norm(to_object)
    along_wall = rise - (rise @ spot.normal) * spot.normal
    spread_m = spot.diameter_m * float(np.linalg.norm(along_wall))
    angle = np.linspace(0.0, np.pi, 129)  # chords of a disc
    return spread_m, variance_lost_to_linewidth(0.5 * spread_m * np.cos(angle), np.sin(angle), spot.linewidth_hz)


def overlap(geometry: Geometry) -> float:
    """Return the fraction of the spot area that consecutive frames share; 0 if each frame has its own spot.

    The fields of the two frames correlate by this fraction, their intensities by its square.
    """
    if geometry.spot.scan_step_m is None or geometry.spot.scan_step_m >= geometry.spot.diameter_m:
        return 0.0
    return float(disc_overlap(geometry.spot.scan_step_m / geometry.spot.diameter_m))


def illuminate(
    geometry: Geometry,
    grid: tuple[int, int],
    streams: Streams,
    number: int,
    *,
    grain: bool = True,
    displaced: Displaced | None = None,
) -> np.ndarray:
    """Return the complex field on the object at the samples of `Geometry.object_pitch_m`; its mean intensity is 1 for a rough wall.

    The heights of the wall multiply the disc of light by random phases 4 pi h / lambda (normal incidence). Each source sample is
    larger than the correlation length of the heights, so phases are independent. Propagation from source to object is Fraunhofer: the
    quadratic phases that it omits are lost in the random phases of both rough surfaces. The light that a smooth wall does not scatter
    is its specular component.

    Args:
        grid: samples (rows, columns) on the object.
        streams: streams(frame) -> random generator of the wall heights and object phases of that frame.
        number: frame number. If the spots of frames overlap, all frames share one random wall and object; otherwise each
            frame has its own.
        grain: whether the speckle of the spot illuminates the object; uniform illumination otherwise.
        displaced: where spot and object are; derived from the frame number if None.

    Returns:
        complex64 (rows, columns), multiplied by the object's own delta-correlated random phase.
    """
    pitch = geometry.object_pitch_m
    scanned = number * (geometry.spot.scan_step_m or 0.0)
    displaced = displaced or Displaced(scanned)
    sharing = overlap(geometry) > 0.0
    # one wall and one object for all frames, or for all sub-exposures of one frame
    shared = sharing or geometry.spot.scan_speed_m_s > 0.0 or displaced.place is not None
    rng = streams(0 if sharing else number)
    own_phase = np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, grid).astype(np.float32))
    if not grain:
        return own_phase
    if grain_m(geometry) < 0.5 * min(pitch) and not shared and specular_share(geometry) < 1e-12:
        # No two samples share a grain: independent circular Gaussians, for any shape of the spot.
        gaussian = rng.standard_normal((2, *grid), np.float32) * np.float32(np.sqrt(0.5))
        return gaussian[0] + 1j * gaussian[1]
    width = max(n * step for n, step in zip(grid, pitch, strict=True))
    reach = lit_period_m(geometry, width) + 2.0 * displaced.reach_m
    wanted = geometry.wavelength_m * geometry.source_distance_m / reach
    across = max(_MIN_SPOT_SAMPLES, int(np.ceil(geometry.spot.diameter_m / wanted)))
    step = geometry.spot.diameter_m / across
    position = (np.arange(across) - 0.5 * (across - 1)) * step
    spot_m = displaced.spot_m if sharing else displaced.spot_m - scanned
    first = math.floor(spot_m / step) if shared else 0
    if shared:  # one more column, over part of which the spot has moved
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
    rows, columns = ((np.arange(n) - 0.5 * (n - 1)) * step for n, step in zip(grid, pitch, strict=True))
    matrix = lit_matrix(geometry)
    if displaced.place is None or displaced.shift_m is not None:
        down, right, away = np.zeros(3) if displaced.shift_m is None else displaced.shift_m
        rows, columns = rows + down, columns + right
        to_rows = _fourier_kernel(matrix[0, 0] * rows, position, geometry)
        # Columns of the grid, and a motion along the line of sight, move along both axes of the spot.
        aside = _fourier_kernel(matrix[0, 1] * columns + matrix[0, 2] * away, position, geometry)
        to_columns = _fourier_kernel(matrix[1, 1] * columns + matrix[1, 2] * away, along, geometry)
        scattered = (to_rows @ ((source @ to_columns.T) * aside.T)) / np.float32(np.sqrt(disc.sum()))
        return (scattered + specular_field(geometry, rows[:, None], columns[None])) * own_phase
    lit_rows, lit_columns = (displaced.coordinates_m @ matrix.T).T
    to_rows, to_columns = _fourier_kernel(lit_rows, position, geometry), _fourier_kernel(lit_columns, along, geometry)
    scattered = ((to_rows @ source) * to_columns).sum(1) / np.float32(np.sqrt(disc.sum()))
    lit = np.zeros(grid, np.complex64)
    rows, columns = displaced.coordinates_m[:, 0], displaced.coordinates_m[:, 1]
    lit[displaced.place] = (scattered + specular_field(geometry, rows, columns)) * own_phase[displaced.place]
    return lit


def specular_part(height_rms_m: float, wavelength_m: float) -> float:
    """Return the fraction of the light that a wall of height rms s reflects specularly, exp(-(4 pi s / lambda)^2) at normal
    incidence (Beckmann)."""
    return float(np.exp(-((4.0 * np.pi * height_rms_m / wavelength_m) ** 2)))


def specular_share(geometry: Geometry) -> float:
    """Return the fraction of the light that the virtual source reflects specularly."""
    return specular_part(geometry.spot.height_rms_m, geometry.wavelength_m)


def specular_field(geometry: Geometry, row_m: np.ndarray, column_m: np.ndarray) -> np.ndarray | float:
    """Return the field of the specular image of the spot at coordinates on the object (broadcast), in units of the Lambertian field there;
    0 for a rough wall.

    It is the Airy pattern of the spot around the specular direction (Goodman, Introduction to Fourier Optics, Eq. 4-30), with an
    irradiance P A / (lambda d1)^2 instead of the Lambertian P / (pi d1^2).
    """
    share = specular_share(geometry)
    if share < 1e-12:
        return 0.0
    spot, hidden = geometry.spot, geometry.hidden_object
    way = hidden.centre - spot.centre + row_m[..., None] * hidden.axes.down + column_m[..., None] * hidden.axes.right
    missed = way / np.linalg.norm(way, axis=-1, keepdims=True) - spot.beam
    missed -= (missed @ spot.normal)[..., None] * spot.normal
    argument = np.pi * spot.diameter_m / geometry.wavelength_m * np.linalg.norm(missed, axis=-1)
    gain = np.pi * (0.25 * np.pi * spot.diameter_m**2) / geometry.wavelength_m**2
    return (np.sqrt(share * gain) * airy(argument)).astype(np.complex64)


def _strip(rng: np.random.Generator, across: int, first: int, count: int) -> np.ndarray:
    """Return columns `first` and following of an infinite strip of random surface heights, (across, count). Each column has
    its own seed.
    """
    seed = int(rng.integers(2**63))
    columns = range(first, first + count)
    return np.stack([np.random.default_rng([seed, column]).standard_normal(across) for column in columns], 1)


def _fourier_kernel(position: np.ndarray, source_position: np.ndarray, geometry: Geometry) -> np.ndarray:
    """Return exp(-2 pi i x s / (lambda d1)) for places x in the laser's speckle and spot samples s, complex64 (samples, sources)."""
    turns = np.outer(position, source_position) / (geometry.wavelength_m * geometry.source_distance_m)
    return np.exp(-2j * np.pi * turns).astype(np.complex64)
