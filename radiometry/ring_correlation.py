"""Resolution of an image: Fourier ring correlation between two images, and its expectation for a mean of speckled images.

The correlation at which the mean over all frames correlates by 1/2 with the noise-free image is 1/7 between halves of the frames
(Rosenthal and Henderson, doi:10.1016/j.jmb.2003.07.013).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from radiometry.motion import disc_overlap

MIN_CORRELATION = 1.0 / 7.0
"""Correlation between the halves at the limit of resolution."""

MIN_CORRELATION_WITH_TRUTH = 0.5
"""Correlation with the noise-free image at the same limit."""

MAX_RINGS = 64
"""Maximum number of rings up to the highest frequency that both axes hold; small images have as many as half of their shorter side."""

MARGIN_CELLS = 8
"""Margin around the object of the image whose resolution is predicted."""


def ring_spectra(first: np.ndarray, second: np.ndarray, pitches: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies of rings in cycles per unit of `pitches`, without zero; and the means over each ring, (3, rings), of the
    cross-spectrum of two images and of their power spectra.
    """
    rings = min(MAX_RINGS, min(first.shape) // 2)
    window = _window(first.shape)
    spectra = [np.fft.fft2((image - image.mean()) * window) for image in (first, second)]
    rows, columns = (np.fft.fftfreq(side, pitch) for side, pitch in zip(first.shape, pitches, strict=True))
    highest = 0.5 / max(pitches)
    ring = np.floor(np.hypot(rows[:, None], columns[None]) * (rings / highest)).astype(int)
    used = ring < rings
    products = ((spectra[0] * spectra[1].conj()).real, np.abs(spectra[0]) ** 2, np.abs(spectra[1]) ** 2)
    sums = np.stack([np.bincount(ring[used], weights=product[used], minlength=rings) for product in products])
    counts = np.bincount(ring[used], minlength=rings)
    return ((np.arange(rings) + 0.5) * (highest / rings))[1:], (sums / counts)[:, 1:]


def fourier_ring_correlation(
    first: np.ndarray, second: np.ndarray, pitches: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies of rings in cycles per unit of `pitches`, without zero, and the correlation of two images on these rings."""
    frequency, (cross, one, other) = ring_spectra(first, second, pitches)
    return frequency, cross / np.sqrt(one * other).clip(1e-300)


def half_period(first: np.ndarray, second: np.ndarray, pitches: tuple[float, float], least: float = MIN_CORRELATION) -> float:
    """Return half of the period at which the ring correlation of two images falls below `least`, in the unit of `pitches`; the limit of
    the cells if it stays above. The default is for the halves of the frames; with a truth, `MIN_CORRELATION_WITH_TRUTH` is the same
    limit.
    """
    return _first_below(*fourier_ring_correlation(first, second, pitches), least)


def speckle_noise(frequency: np.ndarray, cell: float, grain: float) -> np.ndarray:
    """Return the power spectrum of the speckle of |E|^2 at given frequencies, in units of sum r^2.

    Two speckle patterns multiply: that of the illumination, with an intensity covariance mu of coherence area A, and that of the
    object's roughness, which is white. The covariance of the intensities of two points is (1 + mu) (1 + delta) - 1. For cells of
    area a, its spectrum is 1 + A / (A + a) + (A / a) O(f) with the overlap O of two spots, which is zero from 1 / grain on. The second term
    falls from 1 to 0 if a cell holds many grains; its form in between is an approximation.

    Args:
        frequency: in cycles per unit of length.
        cell: area of a cell.
        grain: lambda d / D of a round spot of diameter D at distance d.
    """
    area = 4.0 / math.pi * grain**2
    return 1.0 + area / (area + cell) + area / cell * disc_overlap(frequency * grain)


@dataclass(frozen=True)
class SpeckledImage:
    """Mean |E|^2 of independent fields of an object: which half-period it resolves before it is despeckled.

    The mean of N looks has an N-th of the noise of one. It correlates by 1/2 with the object where the power of the object is a third of
    that.

    Attributes:
        hidden: `sim.transport.hidden_object.HiddenObject` of a scene.
        cells_m: width of the cells of the fields (rows, columns).
        grain_m: speckle grain of the illumination.
    """

    hidden: Any
    cells_m: tuple[float, float]
    grain_m: float

    @cached_property
    def _rings(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Return frequencies, the object's power on rings, and its windowed sum r^2."""
        rows, columns = (
            math.ceil(extent / cell) + 2 * MARGIN_CELLS for extent, cell in zip(self.hidden.extent_m, self.cells_m, strict=True)
        )
        albedo = self.hidden.sample(self.cells_m, (rows, columns)).albedo.astype(np.float64)
        # |E|^2 has the transfer 1 - f of a band-limited field, for f in cycles per cell; means over cells have sinc f.
        down, right = ((1.0 - np.abs(f)) / np.sinc(f) for f in (np.fft.fftfreq(rows), np.fft.fftfreq(columns)))
        seen = np.fft.ifft2(np.fft.fft2(albedo) * down[:, None] * right).real
        frequency, (power, _, _) = ring_spectra(seen, seen, self.cells_m)
        return frequency, power, float(((albedo * _window(albedo.shape)) ** 2).sum())

    def half_period_m(self, looks: int) -> float:
        """Return half of the period at which the mean of a number of looks is expected to correlate by 1/2 with the object."""
        frequency, power, square = self._rings
        noise = square / looks * speckle_noise(frequency, math.prod(self.cells_m), self.grain_m)
        return _first_below(frequency, np.sqrt(power / (power + noise)), MIN_CORRELATION_WITH_TRUTH)


def _window(shape: tuple[int, ...]) -> np.ndarray:
    return np.outer(*(np.hanning(side + 2)[1:-1] for side in shape))


def _first_below(frequency: np.ndarray, correlation: np.ndarray, least: float) -> float:
    """Return half of the period of the first ring whose correlation, averaged with its neighbours, is below `least`."""
    smooth = np.convolve(np.pad(correlation, 1, mode="edge"), np.full(3, 1.0 / 3.0), "valid")
    below = np.flatnonzero(smooth < least)
    return 0.5 / float(frequency[below[0]] if len(below) else frequency[-1])
