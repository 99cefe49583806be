"""Stray laser light: a partially coherent background by clutter and multiple reflections.

Clutter next to the object and reflections between surfaces emit light from a wider region than the object, with other path
lengths, so it adds to the object's light in intensity. Its speckle is that of a source that comprises all positions which emit it
(an extended autocorrelation), as far as pupil and pixel resolve it. Light with unresolved speckle adds a uniform background.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from radiometry.transfer import amplitude_transfer
from sim.geometry import Geometry
from sim.propagation.fraunhofer import far_field
from sim.propagation.sampling import middle

_PAIRS = 20_000


@dataclass(frozen=True)
class Background:
    """Stray light as cells on a periodic grid in the plane of the object; one period of the grid is one period of the wall
    field.

    Attributes:
        share: stray light in units of the hidden object's light.
        place: row and column, modulo the period, of each cell that emits light, (n,) each.
        amplitude: amplitude of each cell, sum of squares 1, (n,).
        coherent: contrast of its speckle before pupil and pixels reduce it; 1 if it comes from a region no larger than the object.
    """

    share: float
    place: tuple[np.ndarray, np.ndarray]
    amplitude: np.ndarray
    coherent: float

    def intensity(self, geometry: Geometry, rng: np.random.Generator, device: torch.device) -> torch.Tensor:
        """Sample its intensity on the canvas, mean 1, before pupil and pixel; (H, W)."""
        if self.coherent == 0.0:
            return torch.ones(geometry.canvas_shape, device=device)
        waves = rng.standard_normal((2, len(self.amplitude))) * np.sqrt(0.5)
        field = np.zeros(geometry.period_shape, np.complex64)
        field[self.place] = (waves[0] + 1j * waves[1]) * self.amplitude
        wall = middle(far_field(torch.from_numpy(field).to(device), geometry.period_shape), geometry.canvas_shape)
        return (wall.real.square() + wall.imag.square()) * self.coherent + (1.0 - self.coherent)


def background_of(geometry: Geometry, even_below: float) -> Background | None:
    """Return the stray light of a scene, None without any; uniform if its speckle adds less than `even_below` to the
    variance of the object's speckle."""
    other, hidden = geometry.other_light, geometry.hidden_object
    if other is None or other.total.per_frame == 0.0 or hidden.throughput == 0.0:
        return None
    share = geometry.other_light_share
    offset = other.position - hidden.centre
    away = np.linalg.norm(hidden.centre - geometry.detector_centre)
    along = away + offset @ hidden.line_of_sight
    # Directions as the frame centre sees them; light from across or behind the line of sight has no lag of its own.
    along = np.where(along > 0.05 * away, along, 0.05 * away)
    seen = hidden.axes.coordinates(offset * (away / along)[:, None])
    cell = np.round(seen / geometry.object_pitch_m).astype(int) % geometry.period_shape
    flat, index = np.unique(cell[:, 0] * geometry.period_shape[1] + cell[:, 1], return_inverse=True)
    power = np.bincount(index, other.weight) / other.weight.sum()
    place = (flat // geometry.period_shape[1], flat % geometry.period_shape[1])

    pairs = np.random.default_rng(0).choice(len(other.weight), (2, _PAIRS), p=other.weight / other.weight.sum())
    lag = (seen[pairs[0]] - seen[pairs[1]]) / geometry.object_pitch_m
    variance = float(_transfer(geometry, lag).mean())
    half = 0.5 * np.array(geometry.period_shape)
    wrapped = float(_transfer(geometry, (lag + half) % (2.0 * half) - half).mean())
    coherent = float(np.sqrt(min(variance / max(wrapped, 1e-12), 1.0)))
    if share**2 * variance < even_below:
        coherent = 0.0
    return Background(share, place, np.sqrt(power), coherent)


def _transfer(geometry: Geometry, lag: np.ndarray) -> np.ndarray:
    """Return H, (n,), at lags (n, 2) in units of the sample spacing of the grid."""
    row, column = (lag / geometry.period_shape / geometry.pixel_pitch_m).T
    return (
        amplitude_transfer(
            row, column, geometry.pixel_pitch_m, geometry.pupil_diameter_m, geometry.wavelength_m, geometry.pupil_distance_m
        )
        ** 2
    )
