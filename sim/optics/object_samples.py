"""The hidden object as samples that propagate: positions, brightness, and the wall that they illuminate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.constants import speed_of_light

from sim.geometry import Geometry
from sim.propagation.sampling import Lattice, Scatterers, Wall, path_difference, phasor


@dataclass(frozen=True)
class ObjectSamples:
    """Samples of a scene's object at `Geometry.object_pitch_m`, without those that are dark.

    Attributes:
        grid: rows and columns of the whole grid, centred on the object.
        place: row and column of each sample, (n,) each.
        position_m: from the object's centre, float64 (n, 3).
        amplitude: square root of the light of a sample: Metzler et al. 2020, Eq. (5), with power albedo, float32 (n,).
        wall: the frame with its border.
        flat_m: position at which FFT propagators place each sample, (n, 2): see `propagation/validity.py`.
        path_m: optical path length from the centre of the spot by each sample to the frame centre, minus the length by the
            object's centre, (n,).
    """

    grid: tuple[int, int]
    place: tuple[np.ndarray, np.ndarray]
    position_m: np.ndarray
    amplitude: np.ndarray
    wall: Wall
    flat_m: np.ndarray
    path_m: np.ndarray
    coordinates_m: np.ndarray
    """Coordinates of each sample along the axes of the object's grid (rows, columns), (n, 2)."""
    part: np.ndarray
    """Index of the hidden object of each sample in `Geometry.movements`, (n,)."""

    @property
    def brightness(self) -> float:
        """Sum of the powers of the samples."""
        return float(np.square(self.amplitude, dtype=np.float64).sum())

    def lit(self, field: np.ndarray, period: tuple[int, int], offset_hz: float = 0.0) -> Scatterers:
        """Return the samples as scatterers lit by a field on the grid (rows, columns); `offset_hz` is the frequency offset
        from the laser.
        """
        delay = phasor(self.path_m * offset_hz, speed_of_light) if offset_hz else 1.0
        return Scatterers(
            self.position_m,
            field[self.place].astype(np.complex128) * self.amplitude * delay,
            Lattice(self.place, self.grid, period),
        )


def sample_object(geometry: Geometry) -> ObjectSamples:
    """Sample the object of a scene at the resolution of its frame."""
    hidden, pitch = geometry.hidden_object, geometry.object_pitch_m
    grid = tuple(
        min(math.ceil(extent / step) + 1, n)
        for extent, step, n in zip(hidden.extent_m, pitch, geometry.period_shape, strict=True)
    )
    seen = hidden.sample(pitch, (grid[0], grid[1]))
    # Relative to the maximum, because throughputs of 1e-20 underflow single precision once they are squared.
    brightness = seen.weight / max(float(seen.weight.max()), 1e-300)
    place = np.nonzero(brightness > 1e-12)
    coordinates = np.stack([(index - 0.5 * (n - 1)) * step for index, n, step in zip(place, grid, pitch, strict=True)], 1)
    position = hidden.position(coordinates, seen.depth_m[place])
    wall = Wall(
        geometry.camera.centre - hidden.centre,
        geometry.camera.right,
        geometry.camera.down,
        geometry.canvas_shape,
        geometry.camera.pixel_pitch_m,
        geometry.wavelength_m,
    )
    path = path_difference(wall.centre_m, position) + path_difference(geometry.spot.centre - hidden.centre, position)
    return ObjectSamples(
        (grid[0], grid[1]),
        place,
        position,
        np.sqrt(brightness[place], dtype=np.float32),
        wall,
        coordinates / hidden.axes.stretch,
        path,
        coordinates,
        seen.part[place],
    )
