"""What the noise floor of a scene is made of, predicted from its light budget and camera."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from correlograph.errors import InputError


@dataclass(frozen=True)
class NoiseTerms:
    """White noise of one pixel and frame, as variances in electrons squared, and the signal they stand against.

    Attributes:
        signal: mean photoelectrons of the hidden object's light (its shot noise is this variance).
        ambient: mean photoelectrons of any other light.
        dark: mean dark electrons.
        read: variance of the read noise.
        quantisation: variance of the converter, step^2 / 12.
        grain_pixels: coherence area of the speckle in pixels.
        detector_grain_pixels: coherence area of the wall's own (subjective) speckle in pixels, 0 when it is left out.
    """

    signal: float
    grain_pixels: float
    ambient: float = 0.0
    dark: float = 0.0
    read: float = 0.0
    quantisation: float = 0.0
    detector_grain_pixels: float = 0.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            # without an object the grain is infinite
            legal = value > 0.0 if name == "grain_pixels" else 0.0 <= value < math.inf
            if not legal:
                raise InputError(name, "a finite variance or mean, zero or more", value, f"correct {name}")

    def over_peak(self) -> dict[str, float | None]:
        """Each term's share of floor over peak; None for all without signal.

        The peak (r*r)(0) of the estimate is signal^2 x grain_pixels. The wall's own speckle multiplies
        the signal by a pattern of contrast 1; with the mean square 2 signal^2 of fully developed
        speckle its spectrum is 2 A_subjective / A_grain of the peak at small lags, whatever the exposure. It
        is not quite white: pupil and pixel halve it towards the outermost lags.
        """
        names = ("signal", "ambient", "dark", "read", "quantisation")
        if self.signal <= 0.0 or not math.isfinite(self.grain_pixels):
            return dict.fromkeys((*names, "detector_speckle"), None)
        shares: dict[str, float | None] = {
            # two divisions: the square of a faint signal would underflow
            name: getattr(self, name) / self.signal / self.signal / self.grain_pixels
            for name in names
        }
        shares["detector_speckle"] = 2.0 * self.detector_grain_pixels / self.grain_pixels
        return shares

    def floor_over_peak(self) -> float | None:
        """b / (r*r)(0) of all terms together."""
        shares = [share for share in self.over_peak().values() if share is not None]
        return math.fsum(shares) if shares else None


def estimate_error(signal_sum: float, signal_square_sum: float, lags: int, floor: float, dof: float) -> float:
    """Relative L2 error of an estimate, floor subtracted: sqrt(sum S^2 / K / sum A^2), S = A + b.

    Args:
        signal_sum, signal_square_sum: sums of A = H (r*r) and A^2 over the lags, A(0) = 1.
        lags: number of lags summed over.
        floor: floor over peak.
    """
    total = signal_square_sum + 2.0 * floor * signal_sum + lags * floor**2
    return math.sqrt(total / (dof * signal_square_sum))
