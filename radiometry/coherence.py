"""Partial coherence: the linewidth of a laser and the spread of path lengths, as an incoherent sum of spectral lines.

The spectrum is Gaussian with full width at half maximum `linewidth`. Its degree of coherence after a delay tau is
gamma(tau) = exp(-(pi linewidth tau)^2 / (4 ln 2)) (Goodman, Statistical Optics, Eq. 5.1-26). Two scatterers whose paths differ
by c tau interfere with that contrast, so the estimate at the lag between them falls by the factor gamma^2.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.constants import speed_of_light

from correlograph.errors import InputError
from radiometry.autocorrelation import autocorrelate

MAX_LINES = 129
_REACH = 3.0
"""Standard deviations of the spectrum on either side that the lines cover."""


def coherence(delay_s: np.ndarray, linewidth_hz: float) -> np.ndarray:
    """Return the degree of coherence gamma after a delay."""
    return np.exp(-((np.pi * linewidth_hz * delay_s) ** 2) / (4.0 * np.log(2.0)))


def reach_m(linewidth_hz: float, least: float = 1e-2) -> float:
    """Return the path difference at which the degree of coherence has fallen to `least`; infinite for a linewidth of zero."""
    if linewidth_hz == 0.0:
        return math.inf
    return speed_of_light * math.sqrt(4.0 * math.log(2.0) * math.log(1.0 / least)) / (math.pi * linewidth_hz)


def variance_lost_to_linewidth(path_m: np.ndarray, amplitude: np.ndarray, linewidth_hz: float, bins: int = 512) -> float:
    """Return 1 - contrast^2 of the speckle: the fraction of its variance that is lost to the linewidth.

    Args:
        path_m: optical path length by each scatterer, (n,). amplitude: of each scatterer, (n,).
    """
    if linewidth_hz == 0.0 or len(path_m) == 0 or np.ptp(path_m) == 0.0:
        return 0.0
    share, edge = np.histogram(path_m, bins, weights=amplitude.astype(np.float64) ** 2)
    share /= share.sum()
    delay = (edge[:-1, None] - edge[None, :-1]) / speed_of_light
    return float(1.0 - share @ coherence(delay, linewidth_hz) ** 2 @ share)


def autocorrelate_coherent(albedo: np.ndarray, path_m: np.ndarray, linewidth_hz: float) -> np.ndarray:
    """Return r*r with every pair of cells lowered by gamma^2 of its path difference; (2n - 1, 2n - 1), zero lag in the middle.

    gamma^2 is the mean of exp(2 pi i f dL / c) over normal frequencies f, whose standard deviation is linewidth / (2 sqrt(ln 2)). r*r is
    therefore the mean autocorrelation of r exp(2 pi i f L / c).

    Args:
        albedo: r (n, n). path_m: optical path by each cell, (n, n).
    """
    lit = albedo > 0.0
    spread = float(np.ptp(path_m[lit])) if lit.any() else 0.0
    if linewidth_hz == 0.0 or spread == 0.0:
        return autocorrelate(albedo)
    deviation = linewidth_hz / (2.0 * math.sqrt(math.log(2.0)))
    # The mean repeats after 1 / spacing, which must exceed the spread of delays by far.
    count = math.ceil(_REACH * deviation * 2.0 * spread / speed_of_light) + 8
    if count > MAX_LINES:
        raise InputError("linewidth", "coherence over a part of the object", f"{linewidth_hz:.3g} Hz", "lower it")
    offset = np.linspace(0.0, _REACH + 1.0, count)
    weight = np.exp(-0.5 * offset**2) * np.where(offset == 0.0, 0.5, 1.0)
    total = np.zeros((2 * len(albedo) - 1,) * 2)
    for frequency, share in zip(offset * deviation, weight / weight.sum(), strict=True):
        turned = albedo * np.exp(2j * np.pi * frequency / speed_of_light * (path_m - path_m[lit].mean()))
        total += share * (autocorrelate(turned.real) + autocorrelate(turned.imag))
    return total


def spectral_lines(path_m: np.ndarray, linewidth_hz: float) -> list[tuple[float, float]]:
    """Return pairs of frequency offset and weight; the incoherent sum of the speckle of these lines represents the laser
    spectrum.

    Raises InputError if the spread of path lengths would need more than `MAX_LINES`.
    """
    deviation = linewidth_hz / (2.0 * math.sqrt(2.0 * math.log(2.0)))
    spread_s = float(np.ptp(path_m)) / speed_of_light
    # The sum repeats after 1 / spacing, which must exceed the spread of delays by a margin.
    count = 2 * math.ceil(_REACH * deviation * max(2.0 * spread_s, 1e-30) + 4) + 1
    if count > MAX_LINES:
        largest = 0.99 * linewidth_hz * ((MAX_LINES - 1) // 2 - 4) / (_REACH * deviation * 2.0 * spread_s)
        raise InputError(
            "linewidth",
            f"at most {largest:.2g} Hz for a spread of paths of {np.ptp(path_m) * 1e3:.3g} mm",
            f"{linewidth_hz:.3g} Hz",
            "the speckle would be gone; lower it",
        )
    offset = np.linspace(-_REACH, _REACH, count)
    weight = np.exp(-0.5 * offset**2)
    return list(zip((offset * deviation).tolist(), (weight / weight.sum()).tolist(), strict=True))
