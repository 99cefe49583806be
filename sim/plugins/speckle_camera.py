"""Sensor `speckle_camera`: a camera focused on the virtual detector, whose shape it is attached to."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from correlograph.errors import InputError
from radiometry.sensor.electronics import Electronics
from sim.plugins.motion import MOTION, read_motion
from sim.plugins.parameters import Parameter, Parameters

ELECTRONIC = (
    Parameter("exposure", "seconds", 1e-30, 1e15),
    Parameter("quantum_efficiency", "", 0.0, 1.0, 1.0),
    Parameter("read_noise", "electrons rms", 1e-30, 1e15, 0.0, zero=True),
    Parameter("row_noise", "electrons rms", 1e-30, 1e15, 0.0, zero=True),
    Parameter("column_noise", "electrons rms", 1e-30, 1e15, 0.0, zero=True),
    Parameter("fixed_pattern", "electrons rms", 1e-30, 1e15, 0.0, zero=True),
    Parameter("dark_current", "electrons per pixel and second", 1e-30, 1e15, 0.0, zero=True),
    Parameter("full_well", "electrons", 1e-30, 1e15, 0.0, zero=True),
    Parameter("bits", "", 1, 32, 0.0, zero=True),
    Parameter("gain", "electrons per number", 1e-30, 1e15, 0.0, zero=True),
    Parameter("gate", "seconds", 1e-30, 1e15, 0.0, zero=True),
)

OPTICAL = (
    Parameter("pixel_pitch", "metres on the sensor", 1e-9, 1e6),
    Parameter("magnification", "", 1e-9, 1e9),
    Parameter("pupil_diameter", "metres", 1e-9, 1e9),
    Parameter("transmission", "", 0.0, 1.0, 1.0),
    Parameter("frame_interval", "seconds", 1e-30, 1e15, 0.0, zero=True),
    Parameter("polarisation_channels", "", 1, 2, 1.0),
)

GATE_TOLERANCE = 0.01
"""Largest difference of the exposure from a whole number of gates, over the exposure."""


class SpeckleCamera(mi.Sensor):
    """Camera along the local +z axis of `to_world`, whose origin is the centre of the pupil.

    Parameters (SI): `to_world`; `pixel_pitch` on the sensor and `magnification` (their ratio is the pitch on the wall);
    `pupil_diameter`; `transmission`; `exposure` and the rest of `Electronics`; `polarisation_channels`, 2 for a camera that records
    two frames of one exposure, each in one of two orthogonal polarisations; `velocity` (vector in m/s) and `trajectory` (a CSV file, see
    `sim/trajectory.py`) of a camera that moves. The film defines the number of pixels.
    """

    def __init__(self, props: mi.Properties) -> None:
        mi.Sensor.__init__(self, props)
        self._parameters = Parameters("speckle_camera", (*OPTICAL, *ELECTRONIC), props)
        self._take()
        if "to_world" not in props:
            raise InputError(
                "speckle_camera.to_world", "a transform that aims the camera", "none", "add a <lookat> to the speckle_camera"
            )
        matrix = np.asarray(props["to_world"].matrix, np.float64)
        self.pupil_centre = matrix[:3, 3]
        self.axis = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        self.up = matrix[:3, 1] / np.linalg.norm(matrix[:3, 1])
        self.trajectory = read_motion("speckle_camera", props)
        if self.trajectory.turns:
            expected, remedy = "a motion without rotation", "describe a small turn by the way of its view on the wall"
            raise InputError("speckle_camera.trajectory", expected, "rotations", remedy)
        self._parameters.refuse_unknown(props.unqueried(), "to_world", *MOTION)

    def _take(self) -> None:
        values = self._parameters
        self.magnification = values["magnification"]
        self.pixel_pitch_m = values["pixel_pitch"] / self.magnification
        channels = values["polarisation_channels"]
        if channels != int(channels):
            raise InputError("speckle_camera.polarisation_channels", "1 or 2", channels, "correct polarisation_channels")
        self.polarisation_channels = int(channels)
        self.pupil_diameter_m, self.transmission = values["pupil_diameter"], values["transmission"] / channels
        self.frame_interval_s = values["frame_interval"]
        # The constructor requires a whole number of bits; other floats fail.
        bits = values["bits"]
        self.electronics = Electronics(
            exposure_s=values["exposure"],
            bits=int(bits) if bits == int(bits) else bits,
            **{one.name: values[one.name] for one in ELECTRONIC if one.name not in ("exposure", "bits")},
        )
        self._check_gates()

    def _check_gates(self) -> None:
        """Raise InputError if the exposure is no whole number of gates."""
        camera = self.electronics
        if camera.gate and abs(camera.gates * camera.gate - camera.exposure_s) > GATE_TOLERANCE * camera.exposure_s:
            expected = f"a gate that divides the exposure of {camera.exposure_s:g} s"
            remedy = f"set gate to {camera.exposure_s / camera.gates:.6g}, or change exposure"
            raise InputError("speckle_camera.gate", expected, camera.gate, remedy)

    def traverse(self, callback):
        self._parameters.traverse(callback)

    def parameters_changed(self, keys=()):
        self._parameters.adopt_changes(self._take)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        return f"SpeckleCamera[pixel_pitch={self.pixel_pitch_m} on the wall, pupil_diameter={self.pupil_diameter_m}]"
