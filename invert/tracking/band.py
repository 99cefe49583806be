"""Frequencies at which frames show speckle, and the size and shape of its grains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.fft import irfft2
from scipy.ndimage import map_coordinates, maximum_filter1d
from scipy.signal.windows import tukey

TAPER, MAX_TAPER = 0.12, 0.48
"""Least and largest fraction of each side of a frame over which the window falls, both ends together."""

FALL_GRAINS = 4.0
"""Least width over which the window falls at each end, in rms radii of a grain along that axis, below the largest fraction."""

MAX_LIKENESS = 0.5
"""Largest autocorrelation of the speckle, over its maximum, halfway between two displacements that are told apart: there, both objects
interfere."""

DIRECTIONS, CONE = 36, 4
"""Number of directions within half a turn in which the autocorrelation is searched, and of those on either side that count as one."""


@dataclass(frozen=True)
class Band:
    """Frequencies at which frames show speckle.

    Attributes:
        shape: pixels of a frame (rows, columns) after binning.
        rows, columns: frequencies in cycles per pixel, (R,) and (C,); columns of zero or more only.
        counts: how often a coefficient stands for itself and its conjugate, (R, C); 0 outside the band.
        signal: power of the speckle, (R, C).
        noise: power of the noise.
        floor: power of the noise, of what the window leaks, and of other objects where they are known; a number or (R, C).
        taper: fraction of each side over which the window falls, both ends together.
        contrast: standard deviation of the speckle over the mean light of the frames, at most 1.
    """

    shape: tuple[int, int]
    rows: np.ndarray
    columns: np.ndarray
    counts: np.ndarray
    signal: np.ndarray
    noise: float
    floor: float | np.ndarray
    taper: float = TAPER
    contrast: float = 1.0

    def part(self, rows: slice) -> Band:
        """Return some rows of the band."""
        floor = self.floor[rows] if isinstance(self.floor, np.ndarray) else self.floor
        return replace(self, rows=self.rows[rows], counts=self.counts[rows], signal=self.signal[rows], floor=floor)

    def image(self, spectrum: np.ndarray) -> np.ndarray:
        """Return the image of a spectrum (R, C) in the band, of the shape of a frame."""
        whole = np.zeros((self.shape[0], self.shape[1] // 2 + 1), spectrum.dtype)
        kept = np.round(self.rows * self.shape[0]).astype(int)
        whole[kept, : len(self.columns)] = np.where(self.counts > 0.0, spectrum, 0.0)
        return irfft2(whole, s=self.shape)

    @cached_property
    def grain_pixels(self) -> float:
        """Width of a grain: one over the rms frequency of the speckle in cycles per pixel, over 2 pi."""
        return float(1.0 / (2.0 * np.pi * max(self.mean_squares.trace(), 1e-12) ** 0.5))

    @cached_property
    def inverse_spread(self) -> np.ndarray:
        """Inverse of the covariance of places on the object along rows and columns, in cycles per pixel, (2, 2): the spectrum of the
        speckle is the autocorrelation of its albedo, whose covariance is twice that of the albedo."""
        return np.linalg.inv(0.5 * self.mean_squares + 1e-12 * np.eye(2))

    @cached_property
    def mean_squares(self) -> np.ndarray:
        """Mean squares and product of the frequencies of the speckle along rows and columns, (2, 2)."""
        power = self.counts * self.signal
        rows, columns = power.sum(1), power.sum(0)
        product = self.rows @ power @ self.columns
        squares = np.array([[rows @ self.rows**2, product], [product, columns @ self.columns**2]])
        return squares / max(power.sum(), 1e-300)

    @cached_property
    def power(self) -> float:
        """Power of the speckle, summed over the band."""
        return float((self.counts * self.signal).sum())

    @cached_property
    def cells(self) -> float:
        """Area of the object, int(w)^2 / int(w^2) of its albedo w, in coefficients of the spectrum."""
        return max(1.0, self.power / max(float(self.signal.max()), 1e-300))

    @cached_property
    def noise_gain(self) -> float:
        """Factor by which the window raises the variance of sums over frequencies, whose noise it correlates."""
        windows = [tukey(side, self.taper) for side in self.shape]
        return float(np.prod([(one**4).mean() / (one**2).mean() ** 2 for one in windows]))

    @cached_property
    def whitening(self) -> np.ndarray:
        """Weights (R, C) at which all frequencies of the band count by their number."""
        return np.where(self.counts > 0.0, self.counts / np.maximum(self.signal + self.floor, 1e-300), 0.0)

    @property
    def is_dim(self) -> bool:
        """Whether the noise exceeds the speckle at every frequency."""
        return bool((self.signal <= self.floor).all())

    @property
    def needs_wider_taper(self) -> bool:
        """Whether the window falls over too few grains, and can fall over more."""
        radii = 1.0 / (2.0 * np.pi * np.sqrt(self.mean_squares.diagonal()))
        falls = 0.5 * self.taper * np.array(self.shape)
        return bool((falls < FALL_GRAINS * radii).any()) and self.taper < MAX_TAPER

    def are_apart(self, differences: np.ndarray) -> np.ndarray:
        """Return whether two objects are told apart if their displacements have differences (..., 2), in pixels: bool (...).

        Parts of the scene beside each other make fringes within a grain. The autocorrelation halfway between the two is therefore the
        largest one from there on in about this direction.
        """
        return self.likeness_beyond(0.5 * np.asarray(differences)) < MAX_LIKENESS

    def likeness_beyond(self, differences: np.ndarray) -> np.ndarray:
        """Return the largest autocorrelation of the speckle over its maximum at displacements (..., 2) in pixels or beyond, in about this
        direction, (...)."""
        directions = np.arctan2(differences[..., 1], differences[..., 0]) / np.pi * DIRECTIONS
        place = np.linalg.norm(differences, axis=-1) / (0.5 * self.grain_pixels)
        chosen = np.round(directions).astype(int) % DIRECTIONS
        found = map_coordinates(self._beyond, [np.ravel(chosen), np.ravel(place)], order=1, mode="nearest")
        return found.reshape(np.shape(place))

    @cached_property
    def _beyond(self) -> np.ndarray:
        """Largest autocorrelation of the speckle from radii on that are half a grain apart, in some directions, (`DIRECTIONS`, n)."""
        likeness = self.image(self.signal)
        radii = np.arange(0.0, 0.5 * min(self.shape), 0.5 * self.grain_pixels)
        angles = np.pi * np.arange(DIRECTIONS)[:, None] / DIRECTIONS
        polar = map_coordinates(likeness, [radii * np.cos(angles), radii * np.sin(angles)], order=1, mode="grid-wrap")
        polar = maximum_filter1d(polar, 2 * CONE + 1, axis=0, mode="wrap")
        return np.maximum.accumulate(polar[:, ::-1], axis=1)[:, ::-1] / likeness[0, 0]

    @cached_property
    def overlap_slopes(self) -> list[np.ndarray]:
        """Slopes of the logarithm of the overlap of two windows over their distance in pixels, along rows (H,) and columns (W,)."""
        slopes = []
        for side in self.shape:
            window = tukey(side, self.taper)
            overlap = np.correlate(window, window, "full")[side - 1 :]
            slopes.append(np.gradient(np.log(np.maximum(overlap, 1e-3 * overlap[0]))))
        return slopes
