"""BSDF `phase_screen`: a rough surface; it reflects like its nested BSDF and adds a random phase to coherent light."""

from __future__ import annotations

import mitsuba as mi

from correlograph.errors import InputError
from sim.plugins.motion import MOTION, read_motion
from sim.plugins.parameters import Parameter, Parameters

PARAMETERS = (
    Parameter("height_rms", "metres", 1e-30, 1e6, zero=True),
    Parameter("correlation_length", "metres", 1e-30, 1e6),
)


class PhaseScreen(mi.BSDF):
    """Parameters (SI): one nested BSDF, `height_rms`, `correlation_length` of the surface heights, `depolarising`
    (whether scattered light is unpolarised; false), and the motion of a hidden object: `velocity` (vector in m/s), `angular_velocity`
    (vector along its axis, in degrees/s), `trajectory` (a CSV file, see `sim/trajectory.py`). Shapes of equal motion turn about their
    common centre."""

    def __init__(self, props: mi.Properties) -> None:
        mi.BSDF.__init__(self, props)
        self._parameters = Parameters("phase_screen", PARAMETERS, props)
        self._take()
        self.trajectory = read_motion("phase_screen", props)
        self.depolarising = bool(props.get("depolarising", False))
        others = {name: props[name] for name in props.unqueried()}
        nested = [value for value in others.values() if isinstance(value, mi.BSDF)]
        unknown = [name for name, value in others.items() if not isinstance(value, mi.BSDF)]
        self._parameters.refuse_unknown(unknown, "depolarising", *MOTION)
        if len(nested) != 1:
            raise InputError("phase_screen", "exactly one nested BSDF", len(nested), 'nest one, such as <bsdf type="diffuse">')
        self.nested = nested[0]
        self.m_components = [self.nested.flags(i) for i in range(self.nested.component_count())]
        self.m_flags = self.nested.flags()

    def _take(self) -> None:
        self.height_rms_m, self.correlation_length_m = self._parameters["height_rms"], self._parameters["correlation_length"]

    def sample(self, ctx, si, sample1, sample2, active=True):
        return self.nested.sample(ctx, si, sample1, sample2, active)

    def eval(self, ctx, si, wo, active=True):
        return self.nested.eval(ctx, si, wo, active)

    def pdf(self, ctx, si, wo, active=True):
        return self.nested.pdf(ctx, si, wo, active)

    def eval_pdf(self, ctx, si, wo, active=True):
        return self.nested.eval_pdf(ctx, si, wo, active)

    def eval_diffuse_reflectance(self, si, active=True):
        return self.nested.eval_diffuse_reflectance(si, active)

    def eval_null_transmission(self, si, active=True):
        return self.nested.eval_null_transmission(si, active)

    def traverse(self, callback):
        self._parameters.traverse(callback)
        callback.put("nested", self.nested, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys=()):
        self._parameters.adopt_changes(self._take)

    def to_string(self) -> str:
        return (
            f"PhaseScreen[\n  height_rms = {self.height_rms_m},\n  correlation_length = {self.correlation_length_m},\n"
            f"  nested = {self.nested}\n]"
        )
