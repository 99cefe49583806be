"""How motion during the exposure reduces the speckle, in closed form.

A frame is the mean intensity over its exposure. Fringes of lag l travel over the wall by `waves(l)` of their own periods and
decorrelate on the way, so the estimate at that lag is multiplied by

    M(l) = 2 int_0^1 (1 - t) c(t) cos(2 pi t waves(l)) dt

(the time-integrated speckle of Goodman, Speckle Phenomena in Optics, section 5.7, lag by lag). c(t) is the correlation of the
intensity after a share t of the exposure, at the place that the speckle has travelled to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import j1

_SHARES = (np.arange(512) + 0.5) / 512


@dataclass(frozen=True)
class Motion:
    """What moves during one exposure.

    Attributes:
        spot_way: way of the laser's spot over the wall, in diameters of the spot.
        object_way_m: way of the object along its axes (down, right), across the line of sight.
        grain_m: of the illumination on the object, lambda d1 / D.
        fringes_per_m2: turns of phase that a displacement of one metre brings to a sample one metre off the object's centre,
            (1 / d1 + 1 / z) / lambda.
    """

    spot_way: float
    object_way_m: tuple[float, float]
    grain_m: float
    fringes_per_m2: float

    @property
    def moves(self) -> bool:
        return bool(self.spot_way or any(self.object_way_m))

    def correlation(self, share: float | np.ndarray) -> np.ndarray:
        """Correlation c of the speckle's intensity with that a share of the exposure later, where it has travelled to."""
        share = np.asarray(share, np.float64)
        field = disc_overlap(self.spot_way * share) * airy(np.pi * np.hypot(*self.object_way_m) * share / self.grain_m)
        return field**2

    def waves(self, row_m: np.ndarray, column_m: np.ndarray) -> np.ndarray:
        """Periods by which the fringes of lags (broadcast) travel during the exposure."""
        return (row_m * self.object_way_m[0] + column_m * self.object_way_m[1]) * self.fringes_per_m2

    def transfer(self, row_m: np.ndarray, column_m: np.ndarray) -> np.ndarray:
        """M at lags of so many metres on the object, broadcast; 1 where nothing moves."""
        waves = self.waves(row_m, column_m)
        weight = 2.0 * (1.0 - _SHARES) * self.correlation(_SHARES) / len(_SHARES)
        found, index = np.unique(np.abs(waves), return_inverse=True)
        return (np.cos(2.0 * np.pi * np.outer(found, _SHARES)) @ weight)[index].reshape(waves.shape)


def disc_overlap(shift: float | np.ndarray) -> np.ndarray:
    """Area that two equal discs share, over that of one; `shift` in their diameters."""
    shift = np.minimum(shift, 1.0)
    return 2.0 / np.pi * (np.arccos(shift) - shift * np.sqrt(1.0 - shift**2))


def airy(argument: float | np.ndarray) -> np.ndarray:
    """2 J1(x) / x, the field of a uniform disc (Goodman, Introduction to Fourier Optics, Eq. 4-31)."""
    safe = np.maximum(np.abs(argument), 1e-6)
    return np.where(np.abs(argument) > 1e-6, 2.0 * j1(safe) / safe, 1.0)
