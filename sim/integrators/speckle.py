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
        self._seen = self._prepared = None

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        del spp, develop, evaluate
        return mi.TensorXf(self._recording(scene, sensor).frame(self.frame, int(seed))[..., None])

    def render_backward(self, *arguments, **named):
        raise RuntimeError("speckle: frames have no derivative by mi.render; sim.gradients differentiates their expectation")

    render_forward = render_backward

    def _recording(self, scene, sensor):
        """Return the recording of a scene by a sensor; it is reused if the scene has not changed."""
        from sim.plan_report import warnings_of
        from sim.recording import Recording
        from sim.scene import Scene

        sensors = scene.sensors()
        if not isinstance(sensor, int) and sensor not in sensors:
            raise InputError("sensor", "a sensor of the scene", f"{sensor!s:.60}", "add it to the scene")
        index = sensor if isinstance(sensor, int) else sensors.index(sensor)
        if self._seen is None or (self._seen.mitsuba, self._seen.sensor) != (scene, sensors[index]):
            self._seen = Scene(scene).through(index)
        plan = self._seen.plan(self.settings)
        if self._prepared is None or self._prepared.plan is not plan:
            self._prepared = Recording(plan, mean=self.mean)
            for warning in warnings_of(plan, 2):
                mi.Log(mi.LogLevel.Warn, f"speckle: {warning}")
        return self._prepared

    def to_string(self) -> str:
        return f"Speckle[frame={self.frame}, accuracy={self.settings.accuracy}, tolerance={self.settings.tolerance}]"
