"""Contributions to the noise floor of a scene, predicted from its light budget and camera."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from correlograph.errors import InputError


@dataclass(frozen=True)
class NoiseTerms:
    """Signal, noise and speckle size of a frame, from which the noise of an estimate follows; variances in electrons squared
    per pixel.

    Attributes:
        signal: mean photoelectrons from the hidden object; their shot noise has this variance.
        ambient: mean photoelectrons from other light.
        dark: mean dark electrons.
        read: variance of the read noise.
        quantisation: variance of the ADC, step^2 / 12.
        grain_pixels: coherence area of the speckle in pixels.
        detector_grain_pixels: coherence area of the subjective speckle of the virtual detector in pixels; 0 if it is omitted.
        gates: number of gates of a photon-counting camera; 0 for other cameras.
        modes: number of incoherent speckle patterns of equal power that share the signal; not necessarily a whole number.
    """

    signal: float
    grain_pixels: float
    ambient: float = 0.0
    dark: float = 0.0
    read: float = 0.0
    quantisation: float = 0.0
    detector_grain_pixels: float = 0.0
    gates: float = 0.0
    modes: float = 1.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            # without an object the grain is infinite
            legal = value > 0.0 if name == "grain_pixels" else 0.0 <= value < math.inf
            if not legal:
                raise InputError(name, "a finite variance or mean, zero or more", value, f"correct {name}")

    def over_peak(self) -> dict[str, float | None]:
        """Return the contribution of each term to floor over peak; every value is None if the scene gives no signal.

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
        if self.gates:
            shares["saturation"] = self._saturation_over_peak()
        return shares

    def _saturation_over_peak(self) -> float:
        """Return what the saturation of counts adds to floor over peak.

        A gate receives x + c photons on average: x of the signal, Gamma-distributed over the pixels with mean mu and M
        modes, and a constant c. Moments of the binomial counts follow from E[exp(-x)] = (1 + mu / M)^-M. In units of
        (r*r)(0) of these counts, their noise is (exp(c) (1 + mu) (1 + 2 mu) - (1 + mu)^2) / (mu^2 gates A) for M = 1.
        """
        mean, constant = self.signal / self.gates, (self.ambient + self.dark) / self.gates
        each = mean / self.modes
        once, twice = (math.exp(-self.modes * math.log1p(times * each)) for times in (1.0, 2.0))
        noise = once * math.expm1(constant) - once * math.expm1(self.modes * (math.log1p(each) - math.log1p(2.0 * each)))
        # (1 + 2 a) / (1 + a)^2 = 1 - (a / (1 + a))^2
        variance = -twice * math.expm1(self.modes * math.log1p(-((each / (1.0 + each)) ** 2)))
        counted = noise / variance / (self.gates * self.modes * self.grain_pixels)
        electronic = (self.read + self.quantisation) / self.signal / self.signal / self.grain_pixels
        shrunk = mean**2 / self.modes * math.exp(2.0 * constant) / variance
        unsaturated = (self.signal + self.ambient + self.dark) / self.signal / self.signal / self.grain_pixels
        return counted - unsaturated + electronic * (shrunk - 1.0)

    def floor_over_peak(self) -> float | None:
        """Return b / (r*r)(0) of all terms together."""
        shares = [share for share in self.over_peak().values() if share is not None]
        return math.fsum(shares) if shares else None


def estimate_error(signal_sum: float, signal_square_sum: float, lags: int, floor: float, dof: float) -> float:
    """Return the relative L2 error of an estimate after subtraction of the floor: sqrt(sum S^2 / (K sum A^2)), S = A + b.

    Args:
        signal_sum, signal_square_sum: sums of A = H (r*r) and of A^2 over the lags, A(0) = 1.
        lags: number of lags in the sums.
        floor: floor over peak.
    """
    total = signal_square_sum + 2.0 * floor * signal_sum + lags * floor**2
    return math.sqrt(total / (dof * signal_square_sum))
