"""Parameters of a sensor, from which its stages follow."""

from __future__ import annotations

from dataclasses import dataclass, fields

from correlograph.errors import InputError, check_positive

MAX_GATES = 1e9
"""More gates are as good as none, and counts of them have no exact 32-bit number."""


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
        shot_noise: whether photons are counted at random.
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
    shot_noise: bool = True

    def __post_init__(self) -> None:
        check_positive("exposure", self.exposure_s)
        for one in fields(self):
            if one.name not in ("exposure_s", "quantum_efficiency", "shot_noise"):
                check_positive(one.name, getattr(self, one.name), zero_allowed=True)
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
        if 0.0 < self.gate * MAX_GATES < self.exposure_s:
            raise InputError(
                "gate", f"at least the exposure of {self.exposure_s:g} s over {MAX_GATES:g}", self.gate, "correct gate"
            )

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

    @property
    def ceiling(self) -> float:
        """Largest value of a pixel in electrons, by the full well or the ADC; 0 without either."""
        if not self.bits:
            return self.full_well
        most = 2**self.bits - 1
        return self.step * (min(round(self.full_well / self.step), most) if self.full_well else most)
