"""One frame, from geometry to photoelectrons: the coherent flow in a few named steps."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import mitsuba as mi
import numpy as np
import torch

from radiometry.errors import InputError
from radiometry.throughput import closed_form
from sim.camera import expose, mean_image, transfer_function
from sim.geometry import Geometry, read_geometry
from sim.illumination import illuminate
from sim.object_samples import sample_object
from sim.plan import Settings, check, choose_propagator
from sim.propagation.direct import direct
from sim.propagation.fraunhofer import fraunhofer
from sim.propagation.fresnel import fresnel
from sim.propagation.nufft import nufft


class Simulation:
    """Everything about a scene that all its frames share; `frame(seed, number)` draws one.

    Raises InputError when the object or the wall cannot be modelled as the settings ask.
    """

    def __init__(self, geometry: Geometry, settings: Settings | None = None, device: str = "cpu") -> None:
        self.settings = settings or Settings()
        self.device = torch.device(device)
        self._transfer = transfer_function(geometry).to(self.device)
        self._look_at(geometry)

    def _look_at(self, geometry: Geometry) -> None:
        check(geometry)
        self.geometry = geometry
        self._samples = sample_object(geometry)
        self.propagator = choose_propagator(geometry, self._samples, self.settings)
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

    def wall_field(self, seed: int, number: int, progress: Callable[[int], object] = lambda parts: None) -> torch.Tensor:
        """Complex field on the wall (H, W) of one frame, its mean square the samples' brightness."""
        samples, wall = self._samples, self._samples.wall
        lit = illuminate(self.geometry, samples.grid, _stream(seed, number, 0))
        chosen = self.propagator
        if chosen.propagator == "fraunhofer":
            return fraunhofer(torch.from_numpy(samples.on_grid(lit)).to(self.device), wall.shape)
        scatterers = samples.lit(lit)
        if chosen.propagator == "fresnel":
            return fresnel(scatterers, samples.place, samples.grid, wall, self.device.type)
        if chosen.propagator == "nufft":
            field = nufft(scatterers, wall, tolerance=chosen.predicted_error, precision=chosen.precision, progress=progress)
        else:
            field = direct(scatterers, wall, precision=chosen.precision, device=self.device.type,
                           visible=self.geometry.hidden_object.visible_from(self.geometry.detector_centre, wall.centre_m),
                           progress=progress)
        return torch.from_numpy(field).to(self.device, torch.complex64)

    def expected(self, seed: int, number: int) -> torch.Tensor:
        """Expected photoelectrons of one frame's speckle, before any noise: float32 (H, W)."""
        if len(self._samples.amplitude) == 0:
            return torch.zeros(self.geometry.frame_shape)
        wall = self.wall_field(seed, number)
        image = mean_image(wall.real.square() + wall.imag.square(), self._transfer)
        return image.mul_(self.mean_photoelectrons / self._samples.brightness).cpu()

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
