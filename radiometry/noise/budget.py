"""Contributions to the noise floor of a scene, predicted from its light budget and camera."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from correlograph.errors import InputError


@dataclass(frozen=True)
class NoiseTerms:
    """White noise per pixel and frame, as variances in electrons squared, and the signal.

    Attributes:
        signal: mean photoelectrons from the hidden object; their shot noise has this variance.
        ambient: mean photoelectrons from other light.
        dark: mean dark electrons.
        read: variance of the read noise.
        quantisation: variance of the ADC, step^2 / 12.
        grain_pixels: coherence area of the speckle in pixels.
        detector_grain_pixels: coherence area of the subjective speckle of the virtual detector in pixels; 0 if it is omitted.
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
        """Return the contribution of each term to floor over peak; None for all without signal.

        The peak (r*r)(0) of the estimate is signal^2 x grain_pixels. The subjective speckle of the virtual detector multiplies the
        signal by a pattern of contrast 1. The mean square of fully developed speckle is 2 signal^2, so the spectrum of that product
        is 2 A_subjective / A_grain of the peak at small lags, at any exposure. It is not quite white: pupil and pixel halve it at
        the outermost lags.
        """
        names = ("signal", "ambient", "dark", "read", "quantisation")
        if self.signal <= 0.0 or not math.isfinite(self.grain_pixels):
            return dict.fromkeys((*names, "detector_speckle"), None)
        shares: dict[str, float | None] = {
            # two divisions, because the square of a faint signal would underflow
            name: getattr(self, name) / self.signal / self.signal / self.grain_pixels
            for name in names
        }
        shares["detector_speckle"] = 2.0 * self.detector_grain_pixels / self.grain_pixels
        return shares

    def floor_over_peak(self) -> float | None:
        """Return b / (r*r)(0) of all terms together."""
        shares = [share for share in self.over_peak().values() if share is not None]
        return math.fsum(shares) if shares else None


def estimate_error(signal_sum: float, signal_square_sum: float, lags: int, floor: float, dof: float) -> float:
    """Return the relative L2 error of an estimate after subtraction of the floor: sqrt(sum S^2 / K / sum A^2), S = A + b.

    Args:
        signal_sum, signal_square_sum: sums of A = H (r*r) and of A^2 over the lags, A(0) = 1.
        lags: number of lags in the sums.
        floor: floor over peak.
    """
    total = signal_square_sum + 2.0 * floor * signal_sum + lags * floor**2
    return math.sqrt(total / (dof * signal_square_sum))
