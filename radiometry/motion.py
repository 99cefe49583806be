"""Reduction of the speckle by motion during the exposure, in closed form.

A frame is the mean intensity over its exposure. Two points of the object that are a lag l apart interfere in fringes on the
wall. During the exposure these move by `waves(l)` periods and decorrelate. The estimate at that lag is therefore multiplied
by

    M(l) = 2 int_0^1 (1 - t) c(t) cos(2 pi t waves(l)) dt

(the time-integrated speckle of Goodman, Speckle Phenomena in Optics, section 5.7, for each lag). c(t) is the correlation of the
intensity after a fraction t of the exposure, at the position to which the speckle has moved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import j1

_STEPS = 2**13
"""Steps of the integral over the time in which the speckle stays correlated."""

_FINER = 128
"""Frequencies per inverse of that time at which the integral is computed; interpolation between them errs by 5e-5."""

_LAST_RING = 40.0
"""Argument of the Airy pattern beyond which the correlation, below 1e-4, counts as zero."""

MAX_TURNS = 0.25
"""Turns of the fringes of opposite edges of the object within one exposure, at most. They lose a fifth of their power."""


@dataclass(frozen=True)
class Motion:
    """Motion during one exposure.

    Attributes:
        spot_way: displacement of the laser spot on the wall, in spot diameters.
        object_way_m: displacement of the object along its axes (rows, columns), across the line of sight.
        lit_way_m: way of the object through the laser's speckle: what of its displacement lies across the ray from the spot.
        grain_m: grain of this speckle, lambda d1 / D.
        turns_per_m: phase turns during the exposure per metre of distance from the object's centre along its axes, (2,): for light along
            the line of sight (1 / d1 + 1 / z) / lambda times the way of the object, less 1 / (lambda z) times that of the camera.
    """

    spot_way: float
    object_way_m: tuple[float, float]
    lit_way_m: float
    grain_m: float
    turns_per_m: np.ndarray

    @property
    def moves(self) -> bool:
        return bool(self.spot_way or self.lit_way_m or any(self.object_way_m) or any(self.turns_per_m))

    @property
    def of_followed_speckle(self) -> Motion:
        """The motion as seen by frames that move along with the speckle."""
        return replace(self, turns_per_m=np.zeros(2))

    def lasting(self, exposures: float) -> Motion:
        """Return the motion in an exposure of another duration, in units of this one."""
        rows, columns = self.object_way_m
        return replace(
            self,
            spot_way=exposures * self.spot_way,
            object_way_m=(exposures * rows, exposures * columns),
            lit_way_m=exposures * self.lit_way_m,
            turns_per_m=exposures * self.turns_per_m,
        )

    def correlation(self, share: float | np.ndarray) -> np.ndarray:
        """Return the correlation c of the speckle intensity with that after a fraction of the exposure, the shift of the
        pattern compensated.
        """
        share = np.asarray(share, np.float64)
        field = disc_overlap(self.spot_way * share) * airy(np.pi * self.lit_way_m * share / self.grain_m)
        return field**2

    def waves(self, row_m: np.ndarray, column_m: np.ndarray) -> np.ndarray:
        """Return the number of periods by which the fringes of lags (broadcast) move during the exposure."""
        rows, columns = self.turns_per_m
        return row_m * rows + column_m * columns

    @property
    def correlated_share(self) -> float:
        """Fraction of the exposure after which the speckle is no longer correlated with that of the start; at most 1."""
        return min(self.correlated_exposures, 1.0)

    @property
    def correlated_exposures(self) -> float:
        """Number of exposures after which the speckle is no longer correlated with that of the start; infinite for one that rests."""
        decay = max(self.spot_way, np.pi * self.lit_way_m / (self.grain_m * _LAST_RING))
        return 1.0 / decay if decay > 0.0 else float("inf")

    def transfer(self, row_m: np.ndarray, column_m: np.ndarray) -> np.ndarray:
        """Return the factor by which motion during the exposure lowers the estimate, at lags in metres on the object (broadcast)."""
        end = self.correlated_share
        share = (np.arange(_STEPS) + 0.5) * (end / _STEPS)
        weight = 2.0 * (1.0 - share) * self.correlation(share) * (end / _STEPS)
        # The cosine transform of all frequencies at once; half a step of phase moves the first sample to its midpoint.
        frequency = np.arange(_FINER * _STEPS // 2 + 1) / (_FINER * end)
        spectrum = np.fft.rfft(weight, _FINER * _STEPS) * np.exp(-1j * np.pi * frequency * (end / _STEPS))
        waves = np.abs(self.waves(row_m, column_m))
        return np.interp(waves, frequency, spectrum.real, right=0.0)


def disc_overlap(shift: float | np.ndarray) -> np.ndarray:
    """Return the area shared by two equal discs as a fraction of the area of one; `shift` is the distance of their centres
    in diameters.
    """
    shift = np.minimum(shift, 1.0)
    return 2.0 / np.pi * (np.arccos(shift) - shift * np.sqrt(1.0 - shift**2))


def airy(argument: float | np.ndarray) -> np.ndarray:
    """Return 2 J1(x) / x, the field of a uniform disc (Goodman, Introduction to Fourier Optics, Eq. 4-31)."""
    safe = np.maximum(np.abs(argument), 1e-6)
    return np.where(np.abs(argument) > 1e-6, 2.0 * j1(safe) / safe, 1.0)
