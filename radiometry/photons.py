"""Photon rate of a laser, and coherence area of the speckle on the virtual detector."""

from __future__ import annotations

import math

import numpy as np
from scipy.constants import Planck, speed_of_light


def photon_rate(power_w: float, wavelength_m: float) -> float:
    """Return the photons per second of `power_w` watts at `wavelength_m`."""
    return power_w * wavelength_m / (Planck * speed_of_light)


def decibel(ratio: float) -> float:
    """Return 10 log10(ratio); minus infinity for zero."""
    return 10.0 * math.log10(ratio) if ratio > 0.0 else -math.inf


def grain_area(
    albedo: np.ndarray, cell_area_m2: float, wavelength_m: float, distance_m: float, square_sum: float | None = None
) -> float:
    """Return the coherence area of the speckle on the virtual detector in m^2.

    (lambda z)^2 (integral r^2) / (integral r)^2, the integral of the squared degree of coherence (Goodman, Speckle Phenomena in
    Optics, 2007, Eq. 4-75, with van Cittert-Zernike).

    Args:
        albedo: power reflectance r on a grid, any shape.
        cell_area_m2: area of one grid cell on the object.
        square_sum: sum of r^2 on a finer grid, per cell; averaging over cells lowers the sum at edges. None: the sum of `albedo`^2.
    """
    power = float(albedo.sum(dtype=np.float64)) * cell_area_m2
    if power == 0.0:
        return math.inf
    squared = (float(np.square(albedo, dtype=np.float64).sum()) if square_sum is None else square_sum) * cell_area_m2
    return (wavelength_m * distance_m) ** 2 * squared / power**2
