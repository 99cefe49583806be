"""Integrator `speckle`: coherent light, so that `mi.render(scene, seed=1)` gives one speckle frame."""

from __future__ import annotations

import mitsuba as mi


class Speckle(mi.SamplingIntegrator):
    """Renders one frame in photoelectrons, shape (height, width, 1); `spp` has no meaning and is ignored."""

    def __init__(self, props: mi.Properties) -> None:
        mi.SamplingIntegrator.__init__(self, props)

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        from sim.frame import Simulation

        del sensor, spp, develop, evaluate
        return mi.TensorXf(Simulation.of_scene(scene).frame(int(seed), 0).numpy()[..., None])

    def to_string(self) -> str:
        return "Speckle[]"
