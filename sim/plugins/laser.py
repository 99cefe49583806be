"""Emitter `laser`: a continuous-wave beam that makes one spot on the virtual source."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from radiometry.errors import InputError, positive


class Laser(mi.Emitter):
    """Beam along the local +z axis of `to_world`.

    Parameters (SI): `to_world`, `wavelength`, `power`, `spot_diameter` (uniform disc on the wall),
    `linewidth` in Hz (full width at half maximum, 0), `scan_step` (way of the spot between frames; its diameter or more).
    """

    def __init__(self, props: mi.Properties) -> None:
        mi.Emitter.__init__(self, props)
        self.m_flags = mi.EmitterFlags.DeltaPosition
        self.m_needs_sample_2 = False
        self.wavelength_m = positive("laser.wavelength", props["wavelength"])
        self.power_w = positive("laser.power", props["power"], zero_allowed=True)
        self.spot_diameter_m = positive("laser.spot_diameter", props["spot_diameter"])
        self.linewidth_hz = positive("laser.linewidth", props.get("linewidth", 0.0), zero_allowed=True)
        step = props.get("scan_step", None)
        self.scan_step_m = None if step is None else positive("laser.scan_step", step, zero_allowed=True)
        if "to_world" not in props:
            raise InputError("laser.to_world", "a transform that aims the beam", "none", "add a <lookat> to the laser")
        matrix = np.asarray(props["to_world"].matrix, np.float64)
        self.origin = matrix[:3, 3]
        self.direction = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])

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
