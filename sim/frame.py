"""One frame, from geometry to photoelectrons: the coherent flow in a few named steps."""

from __future__ import annotations

import math
from copy import copy

import mitsuba as mi
import numpy as np
import torch

from radiometry.errors import InputError
from radiometry.throughput import closed_form
from sim.camera import expose, mean_image, transfer_function
from sim.geometry import Geometry, read_geometry
from sim.illumination import illuminate
from sim.plan import check
from sim.propagation.fraunhofer import fraunhofer


class Simulation:
    """Everything about a scene that all its frames share; `frame(seed, number)` draws one.

    Raises InputError when the object or the wall cannot be modelled as `statistical` accuracy asks.
    """

    def __init__(self, geometry: Geometry, device: str = "cpu") -> None:
        self.device = torch.device(device)
        self._transfer = transfer_function(geometry).to(self.device)
        self._look_at(geometry)

    def _look_at(self, geometry: Geometry) -> None:
        check(geometry)
        self.geometry = geometry
        pitch = geometry.object_pitch_m
        self._grid = tuple(min(math.ceil(extent / step) + 1, n) for extent, step, n in
                           zip(geometry.hidden_object.extent_m, pitch, geometry.frame_shape, strict=True))
        seen = geometry.hidden_object.sample(pitch, self._grid)
        mean_cosine = geometry.light_path.object_cosine_in
        # The paper's Eq. (5) with power albedo: the field is multiplied by its square root.
        brightness = seen.albedo * (seen.cosine_in / mean_cosine if mean_cosine else 1.0)
        self._amplitude = np.sqrt(brightness, dtype=np.float32)
        self._brightness_sum = float(brightness.sum(dtype=np.float64))
        self.budget = closed_form(geometry.light_path)

    def showing(self, cells: np.ndarray, pitch_m: float) -> Simulation:
        """The same simulation with a flat object of albedo cells (n, n) in place of the scene's own."""
        other = copy(self)
        other._look_at(self.geometry.showing(cells, pitch_m))
        return other

    @classmethod
    def of_scene(cls, scene: mi.Scene) -> Simulation:
        return cls(read_geometry(scene))

    @property
    def mean_photoelectrons(self) -> float:
        """Expected photoelectrons of one pixel, over all speckle realisations."""
        return self.budget.photoelectrons_per_pixel_s * self.geometry.electronics.exposure_s

    def expected(self, seed: int, number: int) -> torch.Tensor:
        """Expected photoelectrons of one frame's speckle, before any noise: float32 (H, W)."""
        if self._brightness_sum == 0.0:
            return torch.zeros(self.geometry.frame_shape)
        generator = _stream(seed, number, 0)
        field = illuminate(self.geometry, self._grid, generator) * self._amplitude
        wall = fraunhofer(torch.from_numpy(field).to(self.device), self.geometry.frame_shape)
        image = mean_image(wall.real.square() + wall.imag.square(), self._transfer)
        return image.mul_(self.mean_photoelectrons / self._brightness_sum).cpu()

    def frame(self, seed: int, number: int) -> torch.Tensor:
        """One stored frame in electrons, float32 (H, W).

        Frame `number` of a capture lights another spot of the virtual source, at least a spot
        diameter away, so its speckle is independent; so is its noise.
        """
        noise = expose(self.expected(seed, number).numpy(), self.geometry.electronics, _stream(seed, number, 1))
        return torch.from_numpy(noise)


def _stream(seed: int, number: int, purpose: int) -> np.random.Generator:
    """Random stream of one purpose (0: screens, 1: photons and electronics) of one frame."""
    if seed < 0:
        raise InputError("seed", "zero or a positive whole number", seed, "choose another --seed")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, purpose)))
