"""Predicted errors of the propagators, from geometry alone, for the choice of the propagator.

*Field* error is the relative L2 error of the field of one realisation after the best global phase is removed. Scatterers
have independent phases, so its mean square is that of the propagators over pairs of pixel and scatterer, weighted by
|a_s|^2. A few thousand pairs predict it.

*Statistical* error is the relative L2 error of the expected autocorrelation. In a patch around c a scatterer adds a plane
wave whose fringes have the frequency g(c, s) / lambda (see `nufft.py`), so the expected autocorrelation is that of
scatterers of the same brightness at the positions -d g.
"""

from __future__ import annotations

import numpy as np

from sim.propagation.sampling import Scatterers, Wall, kernel, path_difference, phasor

UNCORRELATED_FIELD_ERROR = float(np.sqrt(2.0))
"""Field error of `fraunhofer`: its phases are those of another realisation; only its statistics are right."""

_PIXELS, _SCATTERERS = 9, 400
ROUNDING = 4e-7
"""Relative error of a single-precision FFT or sum of this size."""


def fresnel_error(wall: Wall, place: np.ndarray, scatterers: Scatterers) -> float:
    """Return the predicted field error of `fresnel`.

    Args:
        place: positions at which FFT propagators place the scatterers, (n, 2): fringes advance by place / (lambda d) per metre
            along the rows and columns of the wall.
    """
    few, place = _sample(scatterers, place)
    row, column = (offset[np.linspace(0, len(offset) - 1, _PIXELS).astype(int)] for offset in wall.offsets())
    row, column = (part.ravel() for part in np.meshgrid(row, column, indexing="ij"))
    pixel = wall.centre_m + row[:, None] * wall.down + column[:, None] * wall.right
    approximate = phasor(-(row[:, None] * place[:, 0] + column[:, None] * place[:, 1]) / wall.distance_m, wall.wavelength_m)
    approximate = approximate * phasor(path_difference(wall.centre_m, few.position_m), wall.wavelength_m)
    exact = kernel(wall, pixel[:, None], few.position_m[None])
    exact /= np.sqrt((np.abs(exact) ** 2).mean(0))  # the power of a scatterer is that of its light in the frame
    # The realised power of n scatterers varies by 1 / sqrt(n) around its mean.
    few_of_them = 1.0 + 1.0 / np.sqrt(len(scatterers))
    return float(np.hypot(few_of_them * _distance(exact, approximate), ROUNDING))


def statistical_error(
    wall: Wall, place: np.ndarray, scatterers: Scatterers, lag_m: float | tuple[float, float], tiles: int = 3
) -> float:
    """Return the predicted error of the expected autocorrelation by `fraunhofer` and `fresnel`, on lags of pitch `lag_m`.

    Args:
        place: see `fresnel_error`. lag_m: lag pitch in the unit of `place`, one number or (rows, columns).
    """
    power = np.abs(scatterers.amplitude) ** 2
    flat = _lags(place, power, lag_m)
    fractions = (np.arange(tiles) + 0.5) / tiles
    seen = np.zeros_like(flat)
    for row in fractions * wall.shape[0]:
        for column in fractions * wall.shape[1]:
            ray = wall.pixels(row, column) - scatterers.position_m
            distance = np.linalg.norm(ray, axis=1)[:, None]
            middle = wall.pixels(row, column)
            gradient = ray / distance - middle / np.linalg.norm(middle)
            shifted = -wall.distance_m * np.stack([gradient @ wall.down, gradient @ wall.right], 1)
            seen += _lags(shifted, power, lag_m) / tiles**2
    seen *= (seen * flat).sum() / (seen * seen).sum()
    return float(np.linalg.norm(seen - flat) / np.linalg.norm(flat))


def direct_error(wall: Wall, scatterers: Scatterers, precision: str, tile: int) -> float:
    """Return the relative rounding error of the direct sum: phase rounding within a tile, and accumulation."""
    if precision == "float64":
        return 1e-11
    reach = float(np.linalg.norm(scatterers.position_m, axis=1).max())
    reach *= max(float(np.linalg.norm(step)) for step in (wall.right, wall.down))
    phase = 2.0 * np.pi / wall.wavelength_m * 0.7 * tile * wall.pitch_m * reach / wall.distance_m
    return ROUNDING + 2e-8 * phase


def _sample(scatterers: Scatterers, place: np.ndarray) -> tuple[Scatterers, np.ndarray]:
    """Sample scatterers and their positions with probability proportional to power; all then have equal weight."""
    power = np.abs(scatterers.amplitude) ** 2
    chosen = np.random.default_rng(0).choice(len(power), _SCATTERERS, p=power / power.sum())
    return Scatterers(scatterers.position_m[chosen], np.ones(_SCATTERERS)), place[chosen]


def _distance(exact: np.ndarray, other: np.ndarray) -> float:
    """Return the relative L2 distance of two kernel matrices (pixels, scatterers), minimised over a global phase."""
    ours, theirs = (np.abs(exact) ** 2).sum(), (np.abs(other) ** 2).sum()
    overlap = abs((exact.conj() * other).sum())
    return float(np.sqrt(max(ours + theirs - 2.0 * overlap, 0.0) / ours))


def _lags(place: np.ndarray, brightness: np.ndarray, pitch_m: float | tuple[float, float], side: int = 128) -> np.ndarray:
    """Return the autocorrelation of brightness at positions (n, 2), distributed bilinearly among cells of `pitch_m`."""
    cell = place / np.asarray(pitch_m) + 0.5 * side
    low = np.clip(np.floor(cell).astype(int), 0, side - 2)
    part = cell - low
    image = np.zeros((side, side))
    for row in (0, 1):
        for column in (0, 1):
            weight = np.abs(1 - row - part[:, 0]) * np.abs(1 - column - part[:, 1])
            np.add.at(image, (low[:, 0] + row, low[:, 1] + column), weight * brightness)
    return np.fft.irfft2(np.abs(np.fft.rfft2(image, s=(2 * side, 2 * side))) ** 2)
