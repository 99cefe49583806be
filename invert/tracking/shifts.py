"""Displacements from cross-spectra: the maximum of a weighted cross-correlation, with its standard error.

An object that moves by u across the line of sight, lit by a laser at rest, moves its speckle over the wall by u (1 + z / d1); d1 is its
distance from the laser spot, z that from the wall (`radiometry/motion.py`). Two frames then share the speckle, shifted, and have
independent noise. With power S of the speckle, of which a share c is common, in noise of power b, the weight S / ((S + b)^2 - (c S)^2) of
the cross-spectrum gives the maximum-likelihood shift (Knapp and Carter, doi:10.1109/TASSP.1976.1162830). The variance of the
maximum is that of the slope of the noise over the squared curvature, which for this weight is the Cramer-Rao bound.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invert.tracking.band import Band

NEWTON_STEPS = 5
MIN_SIGNIFICANCE = 6.0
"""Standard deviations above which a motion counts as found; the highest of a million shifts of noise lies at 5."""

MAX_COMMON = 0.99
"""Share of the speckle that two frames have in common at most, so that bright frames do not rely on their highest frequencies alone."""


@dataclass(frozen=True)
class Weight:
    """Weight of cross-spectra, and the noise that it leaves.

    Attributes:
        values: (R, C), times the number of coefficients that each stands for.
        common: share of the speckle of a frame that others have in common with it.
        products: covariances of the slope by noise times speckle, speckle times speckle, and noise times noise, of one frame with another
            of the same light, (3, 2, 2).
        frames: number of frames in the sum.
        deviation: standard deviation of the cross-correlation of frames that share nothing.
        full: height of the maximum if the speckle is wholly common.
        tilt: slope of the cross-correlation at its maximum, over its height, if frames rather than this sum were multiplied by a function
            whose logarithm rises by one per pixel: along rows and columns (2,) of the slope, and of the function, (2, 2).
    """

    values: np.ndarray
    common: float
    products: np.ndarray
    frames: int
    deviation: float
    full: float
    tilt: np.ndarray

    def part(self, rows: slice) -> Weight:
        """Return the weight of some rows of a band."""
        return replace(self, values=self.values[rows])

    @property
    def slope_variance(self) -> np.ndarray:
        """Covariance of the slope at a maximum, (2, 2), for equal frames."""
        return self.slope_variances(np.ones(1), np.full(1, self.frames), np.full(1, self.frames))[0]

    def slope_variances(self, light: np.ndarray, others: np.ndarray, squares: np.ndarray) -> np.ndarray:
        """Return the covariance of the slope at the maximum of frames of some light (n,) with sums of others, (n, 2, 2).

        All noise is taken for that of photons: its power goes with the light, and is that of the band on average.

        Args:
            others, squares: sums of the light and of its squares over the others, (n,).
        """
        left, photons = 1.0 - self.common, float((light**2).mean() ** 0.5 / light.mean())
        both = light * others
        noise_and_speckle = self.common * both * (light + others) + left * light * (squares + both)
        speckles = left * light**2 * (self.common * others**2 + squares)
        factors = np.stack([photons * noise_and_speckle, speckles, photons**2 * both])
        return np.tensordot(factors, self.products, (0, 0))


def weight_of(band: Band, common: float, frames: int = 1) -> Weight:
    """Return the weight for the cross-spectrum of a frame with the sum of a number of frames, a share of whose speckle is common."""
    common = min(common, MAX_COMMON)
    signal, total = band.signal, band.signal + band.floor
    own = total - common * signal  # noise, and speckle that is not shared
    # Of s (frames s + noise)*: the noise of the frame times the speckle, of the sum times the speckle, and of both.
    left = common * signal * own + (common * signal * own + own**2) / frames
    values = np.where(band.counts > 0.0, signal / np.maximum(left, 1e-300), 0.0)
    turn = (
        2.0 * np.pi * np.broadcast_to(band.rows[:, None], signal.shape),
        2.0 * np.pi * np.broadcast_to(band.columns, signal.shape),
    )
    counted = band.counts * values**2 * band.noise_gain
    products = [
        [[float((counted * power * one * other).sum()) for other in turn] for one in turn]
        for power in (signal * band.floor, signal**2, np.broadcast_to(band.floor, signal.shape) ** 2)
    ]
    null = counted * frames * total**2
    # The correlation times its argument has the derivative of the spectrum as its spectrum.
    falls = [-_slopes(signal, band.counts > 0.0, part, axis) for axis, part in enumerate((band.rows, band.columns))]
    tilt = np.array([[float((band.counts * values * one * fall).sum()) / (2.0 * np.pi) for fall in falls] for one in turn])
    height = float((band.counts * values * signal).sum())
    return Weight(
        band.counts * values,
        common,
        np.array(products),
        frames,
        float(null.sum() ** 0.5),
        height * frames,
        tilt / max(height, 1e-300),
    )


def _slopes(values: np.ndarray, inside: np.ndarray, places: np.ndarray, axis: int) -> np.ndarray:
    """Return the slopes of values (R, C) over places along an axis: the mean of those to the neighbours that are inside."""
    values, inside = np.moveaxis(values, axis, 0), np.moveaxis(inside, axis, 0)
    known = (inside[1:] & inside[:-1]).astype(np.float64)
    steps = known * np.diff(values, axis=0) / np.diff(places)[:, None]
    slopes, neighbours = (np.pad(one, ((0, 1), (0, 0))) + np.pad(one, ((1, 0), (0, 0))) for one in (steps, known))
    return np.moveaxis(slopes / np.maximum(neighbours, 1.0), 0, axis)


def move_back(spectra: np.ndarray, band: Band, pixels: np.ndarray) -> np.ndarray:
    """Return spectra (n, R, C) moved back by displacements (n, 2)."""
    rows = np.exp(2j * np.pi * band.rows * pixels[:, :1]).astype(np.complex64)
    columns = np.exp(2j * np.pi * band.columns * pixels[:, 1:]).astype(np.complex64)
    moved = spectra * rows[:, :, None]
    moved *= columns[:, None, :]
    return moved


def heights_at(cross: np.ndarray, band: Band, weight: Weight, pixels: np.ndarray) -> np.ndarray:
    """Return weighted cross-correlations (n,) at displacements (n, 2), from cross-spectra (n, R, C)."""
    return derivatives(moments(cross * weight.values.astype(np.float32), band, pixels))[0]


def refine(
    cross: np.ndarray, band: Band, weight: Weight, start: np.ndarray, scales: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement (2,) whose multiples by scales (n,) have the highest sum in the cross-correlations of cross-spectra
    (n, R, C), the one nearest to a start (2,) by Newton's method, and the height in each, (n,)."""
    pixels, reach = start.astype(np.float64).copy(), band.grain_pixels
    weighted = cross * weight.values.astype(np.float32)
    # Away from a maximum, the curvature expected there keeps the step uphill.
    usual = np.trace(weight.slope_variance) / max(weight.full, 1e-300) * float(scales @ scales)
    for _ in range(NEWTON_STEPS):
        _, slopes, curvatures = derivatives(moments(weighted, band, scales[:, None] * pixels))
        bent = _downward(np.tensordot(scales**2, curvatures, 1), usual)
        pixels += np.clip(-np.linalg.solve(bent, scales @ slopes), -reach, reach)
    heights, _, curvatures = derivatives(moments(weighted, band, scales[:, None] * pixels))
    bent = _downward(np.tensordot(scales**2, curvatures, 1), 1e-9 * max(weight.full, 1e-300))
    # The overlap of two windows falls with their distance, which draws a maximum towards zero.
    drawn = heights[:, None] * (window_slopes(scales[:, None] * pixels, band) @ weight.tilt.T)
    return pixels + np.linalg.solve(bent, scales @ drawn), heights


def moments(weighted: np.ndarray, band: Band, pixels: np.ndarray) -> np.ndarray:
    """Return the sums over all frequencies of weighted cross-spectra (n, R, C), moved back by displacements (n, 2), times powers 0 to 2 of
    the angular frequencies along rows and columns, (n, 3, 3)."""

    def powers(frequencies: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        turns = 2.0 * np.pi * frequencies
        phases = np.exp(1j * turns * shifts[:, None])
        return np.stack([phases, turns * phases, turns**2 * phases], 1).astype(np.complex64)  # (n, 3, frequencies)

    # Dot products take a fraction of the time of a matrix product, whose threads would wait for each other.
    along = np.vecdot(powers(band.columns, -pixels[:, 1])[:, None], weighted[:, :, None])  # (n, R, 3), the first one conjugated
    return (powers(band.rows, pixels[:, 0]) @ along).astype(np.complex128)


def derivatives(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return cross-correlations (n,), their slopes (n, 2) and curvatures (n, 2, 2) from `moments`."""
    slope = -np.stack([sums[:, 1, 0].imag, sums[:, 0, 1].imag], -1)
    curvature = -np.stack([sums[:, 2, 0].real, sums[:, 1, 1].real, sums[:, 1, 1].real, sums[:, 0, 2].real], -1)
    return sums[:, 0, 0].real, slope, curvature.reshape(-1, 2, 2)


def fold(pixels: np.ndarray, band: Band) -> np.ndarray:
    """Return displacements (..., 2) within half a frame of zero, by whole sides."""
    sides = np.array(band.shape)
    return pixels - sides * np.round(pixels / sides)


def overlap_share(pixels: np.ndarray, band: Band) -> np.ndarray:
    """Return the share of a frame that overlaps with one at displacements (..., 2), (...)."""
    return np.prod(np.maximum(1.0 - np.abs(pixels) / np.array(band.shape), 0.0), axis=-1)


def _downward(curvature: np.ndarray, least: float) -> np.ndarray:
    """Return a matrix (2, 2) whose eigenvalues are at most -least."""
    values, vectors = np.linalg.eigh(curvature)
    return (vectors * np.minimum(values, -least)) @ vectors.T


def window_slopes(pixels: np.ndarray, band: Band) -> np.ndarray:
    """Return the slopes of the logarithm of the overlap of two windows at displacements (..., 2) along rows and columns, (..., 2)."""
    slopes = [
        np.sign(along) * np.interp(np.abs(along), np.arange(len(slope)), slope)
        for along, slope in zip(np.moveaxis(pixels, -1, 0), band.overlap_slopes, strict=True)
    ]
    return np.stack(slopes, -1)
