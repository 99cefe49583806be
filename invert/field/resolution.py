"""Resolution of the fine albedo: Fourier ring correlation between the mean intensities of two halves of the frames.

The correlation at which the mean over all frames correlates by 1/2 with the noise-free image is 1/7 between the halves
(Rosenthal and Henderson, doi:10.1016/j.jmb.2003.07.013).
"""

from __future__ import annotations

import numpy as np

MIN_CORRELATION = 1.0 / 7.0
"""Correlation between the halves at the limit of resolution."""

MAX_RINGS = 64
"""Maximum number of rings up to the highest frequency that both axes hold; small images have as many as half of their shorter side."""


def fourier_ring_correlation(
    first: np.ndarray, second: np.ndarray, pitches: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies of rings in cycles per unit of `pitches`, without zero, and the correlation of two images on these rings."""
    rings = min(MAX_RINGS, min(first.shape) // 2)
    window = np.outer(*(np.hanning(side + 2)[1:-1] for side in first.shape))
    spectra = [np.fft.fft2((image - image.mean()) * window) for image in (first, second)]
    rows, columns = (np.fft.fftfreq(side, pitch) for side, pitch in zip(first.shape, pitches, strict=True))
    highest = 0.5 / max(pitches)
    ring = np.floor(np.hypot(rows[:, None], columns[None]) * (rings / highest)).astype(int)
    used = ring < rings
    sums = [
        np.bincount(ring[used], weights=values[used], minlength=rings)
        for values in ((spectra[0] * spectra[1].conj()).real, np.abs(spectra[0]) ** 2, np.abs(spectra[1]) ** 2)
    ]
    correlation = sums[0] / np.sqrt(sums[1] * sums[2]).clip(1e-300)
    return ((np.arange(rings) + 0.5) * (highest / rings))[1:], correlation[1:]


def half_period(first: np.ndarray, second: np.ndarray, pitches: tuple[float, float], least: float = MIN_CORRELATION) -> float:
    """Return half of the period at which the ring correlation of two images falls below `least`, in the unit of `pitches`; the limit of
    the cells if it stays above. The default is for the halves of the frames; with a truth, 1 / 2 is the same limit.
    """
    frequency, correlation = fourier_ring_correlation(first, second, pitches)
    smooth = np.convolve(np.pad(correlation, 1, mode="edge"), np.full(3, 1.0 / 3.0), "valid")
    below = np.flatnonzero(smooth < least)
    return 0.5 / float(frequency[below[0]] if len(below) else frequency[-1])
