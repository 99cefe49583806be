"""Integrator `speckle`: coherent light; `mi.render(scene, seed=1)` renders one speckle frame."""

from __future__ import annotations

import mitsuba as mi

from correlograph.errors import InputError


class Speckle(mi.SamplingIntegrator):
    """Render one frame in photoelectrons, shape (height, width, 1); `spp` has no meaning and is ignored.

    Parameters, as for `python -m sim`: `frame` (number in its capture, 0), `accuracy`, `tolerance`, `propagator`, `precision`,
    `effects` (`name=on|off`, separated by commas), `mean` (expected photoelectrons, no noise). Frames of an unchanged scene
    share their preparation. Warnings go to Mitsuba's log.
    """

    def __init__(self, props: mi.Properties) -> None:
        from sim.effects import parse_effects
        from sim.plan import Settings

        mi.SamplingIntegrator.__init__(self, props)
        self.frame = int(props.get("frame", 0))
        if self.frame < 0:
            raise InputError("speckle.frame", "a whole number, zero or more", self.frame, "correct the value")
        effects = [text.strip() for text in str(props.get("effects", "")).split(",") if text.strip()]
        self.settings = Settings(
            str(props.get("accuracy", "statistical")),
            float(props.get("tolerance", 1e-2)),
            str(props.get("propagator", "auto")),
            props.get("precision", None),
            parse_effects(effects),
        )
        self.mean = bool(props.get("mean", False))
        self._prepared: tuple[object, object] | None = None

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        del spp, develop, evaluate
        simulation = self._simulation(scene, sensor)
        draw = simulation.expected_frame if self.mean else simulation.frame
        return mi.TensorXf(draw(int(seed), self.frame).numpy()[..., None])

    def render_backward(self, *arguments, **named):
        raise RuntimeError("speckle: frames have no derivative by mi.render; sim.gradients differentiates their expectation")

    render_forward = render_backward

    def _simulation(self, scene, sensor):
        """Return the prepared simulation; it is reused if the scene has not changed."""
        from sim.frame import Simulation
        from sim.plan_report import warnings_of
        from sim.scene_reader import fingerprint, read_geometry

        camera = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        state = (id(scene), id(camera), fingerprint(scene))
        if self._prepared is None or self._prepared[0] != state:
            simulation = Simulation(read_geometry(scene, camera), self.settings)
            for warning in warnings_of(simulation.plan, 2):
                mi.Log(mi.LogLevel.Warn, f"speckle: {warning}")
            self._prepared = (state, simulation)
        return self._prepared[1]

    def to_string(self) -> str:
        return f"Speckle[frame={self.frame}, accuracy={self.settings.accuracy}, tolerance={self.settings.tolerance}]"
