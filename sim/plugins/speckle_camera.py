"""Sensor `speckle_camera`: a camera focused on the virtual detector, whose shape it is attached to."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from correlograph.errors import InputError, check_positive
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

PARAMETERS = tuple(parameter.name for parameter in ELECTRONIC[1:])


@dataclass(frozen=True)
class Electronics:
    """Conversion of photoelectrons to digital numbers. Electrons and seconds; 0 disables an effect.

    Attributes:
        read_noise: standard deviation per pixel.
        row_noise, column_noise: standard deviation of the offset of a whole row or column, independent in each frame.
        fixed_pattern: dark-signal non-uniformity (DSNU): standard deviation of each pixel's offset, equal in all frames.
        dark_current: electrons per pixel and second.
        full_well: electrons at which a pixel saturates.
        bits: bits of the ADC; its range is `gain` times its largest number if `gain` is given, the full well otherwise.
        gain: electrons per digital number.
        gate: duration in which a pixel of a photon-counting camera counts at most one photon; gates fill the exposure.
    """

    exposure_s: float
    quantum_efficiency: float = 1.0
    read_noise: float = 0.0
    row_noise: float = 0.0
    column_noise: float = 0.0
    fixed_pattern: float = 0.0
    dark_current: float = 0.0
    full_well: float = 0.0
    bits: int = 0
    gain: float = 0.0
    gate: float = 0.0

    def __post_init__(self) -> None:
        check_positive("exposure", self.exposure_s)
        for name in PARAMETERS[1:]:
            check_positive(name, getattr(self, name), zero_allowed=True)
        if not 0.0 <= self.quantum_efficiency <= 1.0:
            raise InputError("quantum_efficiency", "a ratio between 0 and 1", self.quantum_efficiency, "correct the value")
        if self.bits != int(self.bits) or self.bits > 32:
            raise InputError("bits", "a whole number up to 32", self.bits, "correct the value")
        if self.bits and not (self.full_well or self.gain):
            raise InputError(
                "bits",
                "a full_well or a gain, which gives the converter's range",
                "bits without either",
                "add full_well to the speckle_camera",
            )
        if self.gain and not self.bits:
            raise InputError("gain", "bits as well", "gain without bits", "add bits to the speckle_camera")
        if self.gate > self.exposure_s:
            raise InputError("gate", f"at most the exposure of {self.exposure_s:g} s", self.gate, "correct gate")

    @property
    def gates(self) -> float:
        """Number of gates in an exposure, and of photons that a pixel can count; 0 for a camera without gates."""
        return float(round(self.exposure_s / self.gate)) if self.gate else 0.0

    @property
    def step(self) -> float:
        """Electrons per digital number of the ADC, 0 without one."""
        if not self.bits:
            return 0.0
        return self.gain or self.full_well / (2**self.bits - 1)


class SpeckleCamera(mi.Sensor):
    """Camera along the local +z axis of `to_world`, whose origin is the centre of the pupil.

    Parameters (SI): `to_world`; `pixel_pitch` on the sensor and `magnification` (their ratio is the pitch on the wall);
    `pupil_diameter`; `transmission`; `exposure` and the rest of `Electronics`; `polarisation_channels`, 2 for a camera that records
    two frames of one exposure, each in one of two orthogonal polarisations. The film defines the number of pixels.
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
            **{name: values[name] for name in PARAMETERS if name != "bits"},
        )

    def traverse(self, callback):
        self._parameters.traverse(callback)

    def parameters_changed(self, keys=()):
        self._parameters.adopt_changes(self._take)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        return f"SpeckleCamera[pixel_pitch={self.pixel_pitch_m} on the wall, pupil_diameter={self.pupil_diameter_m}]"
