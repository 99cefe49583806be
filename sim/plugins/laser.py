"""Emitter `laser`: a continuous-wave beam that produces one spot on the virtual source."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from correlograph.errors import InputError
from sim.plugins.parameters import Parameter, Parameters

PARAMETERS = (
    Parameter("wavelength", "metres", 1e-9, 1.0),
    Parameter("power", "watts", 1e-30, 1e15, zero=True),
    Parameter("spot_diameter", "metres", 1e-9, 1e6),
    Parameter("scan_speed", "metres per second on the wall", 1e-30, 1e9, 0.0, zero=True),
    Parameter("linewidth", "hertz (full width at half maximum)", 1e-30, 1e15, 0.0, zero=True),
)
_SCAN_STEP = Parameter("scan_step", "metres", 1e-30, 1e15, zero=True)


class Laser(mi.Emitter):
    """Beam along the local +z axis of `to_world`.

    Parameters: `to_world`, `wavelength`, `power`, `spot_diameter` (uniform disc on the wall), `linewidth`, `scan_step` (displacement
    of the spot between frames; at least its diameter if omitted), `scan_speed` (during the exposure).
    """

    def __init__(self, props: mi.Properties) -> None:
        mi.Emitter.__init__(self, props)
        self.m_flags = mi.EmitterFlags.DeltaPosition
        self.m_needs_sample_2 = False
        self._parameters = Parameters("laser", PARAMETERS, props)
        step = props.get("scan_step", None)
        self.scan_step_m = None if step is None else _SCAN_STEP.validate("laser", step)
        if "to_world" not in props:
            raise InputError("laser.to_world", "a transform that aims the beam", "none", "add a <lookat> to the laser")
        matrix = np.asarray(props["to_world"].matrix, np.float64)
        self.origin = matrix[:3, 3]
        self.direction = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        self._take()
        self._parameters.refuse_unknown(props.unqueried(), "to_world", "scan_step")

    def _take(self) -> None:
        values = self._parameters
        self.wavelength_m, self.power_w = values["wavelength"], values["power"]
        self.spot_diameter_m, self.linewidth_hz = values["spot_diameter"], values["linewidth"]
        self.scan_speed_m_s = values["scan_speed"]

    def traverse(self, callback):
        self._parameters.traverse(callback)

    def parameters_changed(self, keys=()):
        self._parameters.adopt_changes(self._take)

    # To Mitsuba's own integrators the beam is dark: coherent light is the `speckle` integrator's, and
    # ambient light is whatever the other emitters give.

    def eval(self, si, active=True):
        return mi.Spectrum(0.0)

    def sample_direction(self, it, sample, active=True):
        return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0.0)

    def pdf_direction(self, it, ds, active=True):
        return mi.Float(0.0)

    def eval_direction(self, it, ds, active=True):
        return mi.Spectrum(0.0)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        return f"Laser[wavelength={self.wavelength_m}, power={self.power_w}, spot_diameter={self.spot_diameter_m}]"
