"""Laser light other than by a single reflection off the hidden object: a partially coherent background.

Clutter beside the object and reflections between surfaces send light from a wider region than the object, with paths of their
own, so it adds to the object's in intensity. Its speckle is that of all the places that it comes from (an extended
autocorrelation), as far as pupil and pixel resolve it; light whose speckle is not resolved adds an
even background.
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
    """Other light on the lattice of a frame's period.

    Attributes:
        share: its light over the hidden object's.
        place: row and column, modulo the period, of each cell that light comes from, (n,) each.
        amplitude: of each cell, mean square 1 in sum, (n,).
        coherent: contrast of its speckle before pupil and pixel; 1 where it comes from a region as narrow as an object.
    """

    share: float
    place: tuple[np.ndarray, np.ndarray]
    amplitude: np.ndarray
    coherent: float

    def intensity(self, geometry: Geometry, rng: np.random.Generator, device: torch.device) -> torch.Tensor:
        """One draw of its intensity on the canvas, mean 1, before pupil and pixel; (H, W)."""
        if self.coherent == 0.0:
            return torch.ones(geometry.canvas_shape, device=device)
        waves = rng.standard_normal((2, len(self.amplitude))) * np.sqrt(0.5)
        field = np.zeros(geometry.period_shape, np.complex64)
        field[self.place] = (waves[0] + 1j * waves[1]) * self.amplitude
        wall = middle(far_field(torch.from_numpy(field).to(device), geometry.period_shape), geometry.canvas_shape)
        return (wall.real.square() + wall.imag.square()) * self.coherent + (1.0 - self.coherent)


def background_of(geometry: Geometry, even_below: float) -> Background | None:
    """The background of a scene, None without any; even where its speckle adds less than `even_below` to the object's
    variance."""
    other, hidden = geometry.other_light, geometry.hidden_object
    if other is None or other.total.per_frame == 0.0 or hidden.throughput == 0.0:
        return None
    share = geometry.other_light_share
    offset = other.position - hidden.centre
    away = np.linalg.norm(hidden.centre - geometry.detector_centre)
    along = away + offset @ hidden.line_of_sight
    # In directions, as the frame's centre sees them; what lies across or behind the wall's sight has no lag of its own.
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
    """H at lags (n, 2) in cells of the period's lattice, (n,)."""
    row, column = (lag / geometry.period_shape / geometry.pixel_pitch_m).T
    return (
        amplitude_transfer(
            row, column, geometry.pixel_pitch_m, geometry.pupil_diameter_m, geometry.wavelength_m, geometry.pupil_distance_m
        )
        ** 2
    )
