"""Exact paths of several objects together, by maximum likelihood.

The pattern of each object is a Gaussian random field of known power S that travels along its path p and fades as the illumination on the
object changes; noise and interference N are white. The spectra of frames t and s at a frequency f then have the covariance

    C_ts = sum over objects S(f) exp(-fading (t - s)^2) exp(-2 pi i f (p_t - p_s)), plus N(f) if t = s,

and the most probable paths follow by Fisher scoring (Slepian and Bangs: P. Stoica, R. Moses, Spectral Analysis of Signals, 2005, appendix
B). No pattern needs to be known, and none draws the path of another, whether they overlap or not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from invert.tracking.follow import Followed, approximate, walk_by_change
from invert.tracking.mixture import Mixture, unmix
from invert.tracking.parts import on_all_cores
from invert.tracking.spectra import Band
from invert.tracking.start import Start

WINDOW = 32
"""Number of frames that are compared with one another, at most. In longer captures, windows overlap by half."""

PART = 256
"""Number of frequencies whose matrices are inverted at a time."""

FIRST_FREQUENCIES = 4000
"""Number of frequencies, drawn at random, of all rounds before the last one, and of the information."""

ROUNDS = 6
CONVERGED_GRAINS = 0.02
"""Largest change of a displacement between neighbours, in radii of a grain, at which the first rounds end."""

MAX_ERROR_GRAINS = 2.0
"""Largest standard error of a position between known neighbours, in radii of a grain: beyond it, the likelihood is no parabola. In less
light, every second position is estimated, every fourth, and so on, with straight lines between them."""

MIN_POSITIONS = 4
MAX_CORRECTION = 6.0
"""Radii of a grain by which an exact path may differ from the approximate one where it could change to another object."""

SAMPLED = 64
"""Number of positions whose errors are computed; those between are interpolated."""


def follow_several(spectra: np.ndarray, band: Band, starts: Sequence[Start]) -> list[Followed]:
    """Return the paths of several objects near approximate ones, from spectra (frames, R, C).

    The approximate paths are returned where the light does not suffice, or where a path leaves its surroundings.
    """
    begun = np.stack([one.path for one in starts]).astype(np.float64)
    mixture, places = unmix(spectra, band, begun), np.argwhere(band.counts > 0.0)
    shares = mixture.in_common(band, len(spectra))
    few = np.random.default_rng(0).permutation(len(places))[:FIRST_FREQUENCIES]
    normal = Normal.of(spectra, band, mixture, places[few]).informed(begun)
    length = normal.shortest(MAX_ERROR_GRAINS * band.grain_pixels / band.noise_gain**0.5)
    if length is not None:
        paths = replace(normal, length=length).ascend(begun, band.grain_pixels)
        mixture = unmix(spectra, band, paths)
        informed = Normal.of(spectra, band, mixture, places[few]).informed(paths)
        normal = replace(Normal.of(spectra, band, mixture, places), informations=informed.informations, length=length)
        paths = paths + normal.solve(paths)
        if np.abs(paths - begun).max() < MAX_CORRECTION * band.grain_pixels:
            return _told(band, paths, normal, mixture)
    return [
        replace(approximate(one, band), power=power, in_common=share)
        for one, power, share in zip(starts, mixture.powers, shares, strict=True)
    ]


def _told(band: Band, paths: np.ndarray, normal: Normal, mixture: Mixture) -> list[Followed]:
    """Return the paths (n, frames, 2) with their errors: those of the noise, and by the change of the illumination."""
    variances, bends = normal.errors()
    found = []
    for number, share in enumerate(mixture.in_common(band, paths.shape[1])):
        path, power, fading = paths[number] - paths[number, 0], mixture.powers[number], float(mixture.fading[number])
        walked, _ = walk_by_change(path, fading, replace(band, signal=power))
        error = np.sqrt(band.noise_gain * variances[number] + walked)
        bend_error = np.sqrt(band.noise_gain * bends[number])
        found.append(Followed(path, error, normal.length, bend_error=bend_error, fading=fading, power=power, in_common=share))
    return found


@dataclass(frozen=True)
class Normal:
    """Normal equations of the corrections of paths.

    Attributes:
        turns: angular frequencies in radians per pixel, (K, 2).
        counts: number of coefficients that each of them stands for, (K,).
        values: spectra, (K, frames).
        powers, noise: of the objects, (n, K), and of all else, (K,).
        fading: of the objects, (n,).
        informations: Fisher information of the positions in each window, (L, n, 2, L, n, 2) each.
        length: distance of the positions that are estimated.
    """

    turns: np.ndarray
    counts: np.ndarray
    values: np.ndarray
    powers: np.ndarray
    noise: np.ndarray
    fading: np.ndarray
    informations: tuple[np.ndarray, ...] = ()
    length: int = 1

    @classmethod
    def of(cls, spectra: np.ndarray, band: Band, mixture: Mixture, places: np.ndarray) -> Normal:
        """Return the equations from the frequencies at some places (K, 2) of a band, without information."""
        row, column = places.T
        share = float((band.counts > 0.0).sum()) / len(places)
        return cls(
            2.0 * np.pi * np.stack([band.rows[row], band.columns[column]], 1),
            0.5 * share * band.counts[row, column],
            np.ascontiguousarray(spectra[:, row, column].T),
            mixture.powers[:, row, column].astype(np.float32),
            mixture.noise[row, column].astype(np.float32),
            mixture.fading,
        )

    def informed(self, paths: np.ndarray) -> Normal:
        """Return the equations with the information near some paths (n, frames, 2)."""
        return replace(self, informations=tuple(self._sum(paths, window, _information) for window in self.windows()))

    @property
    def frames(self) -> int:
        return self.values.shape[1]

    def ascend(self, paths: np.ndarray, grain_pixels: float) -> np.ndarray:
        """Return paths (n, frames, 2) moved up their likelihood, by at most the radius of a grain between neighbours at a time."""
        for _ in range(ROUNDS):
            step = self.solve(paths)
            largest = float(np.abs(np.diff(step, axis=1)).max()) / grain_pixels
            paths = paths + step * min(1.0, 1.0 / max(largest, 1e-9))
            if largest < CONVERGED_GRAINS:
                break
        return paths

    def windows(self) -> list[slice]:
        """Return windows of frames; of several, which overlap by half, each counts half."""
        count = max(1, math.ceil(2 * self.frames / WINDOW) - 1)
        firsts = np.linspace(0, max(0, self.frames - WINDOW), count).astype(int)
        return [slice(int(first), min(int(first) + WINDOW, self.frames)) for first in firsts]

    def shortest(self, error: float) -> int | None:
        """Return the shortest distance of positions whose errors between known neighbours are below a limit; None if there is none."""
        length = 1
        while (self.frames - 1) // length + 1 >= MIN_POSITIONS:
            own = replace(self, length=length)._matrix()[0].reshape(-1, 2 * len(self.powers))
            if float(np.median(own[1:], 0).min()) > error**-2:
                return length
            length *= 2
        return None

    def solve(self, paths: np.ndarray) -> np.ndarray:
        """Return the corrections (n, frames, 2) of paths: the score over the information."""
        hats, count = self._hats(slice(0, self.frames)), len(self.powers)
        found = cho_solve_banded((self._factor(), True), (hats.T @ self.score(paths).reshape(self.frames, -1)).ravel())
        return np.moveaxis((hats @ found.reshape(-1, 2 * count)).reshape(self.frames, count, 2), 0, 1)

    def score(self, paths: np.ndarray) -> np.ndarray:
        """Return the slope of the log-likelihood with the position in each frame, (frames, n, 2)."""
        windows, total = self.windows(), np.zeros((self.frames, len(self.powers), 2))
        for window in windows:
            total[window] += self._sum(paths, window, _score) / min(len(windows), 2)
        return total

    def errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the variances of the positions from the first, (n, frames, 2), and of second differences, (n, 2)."""
        factor, size = self._factor(), 2 * len(self.powers)
        positions = factor.shape[1] // size
        chosen = np.unique(np.linspace(0, positions - 1, SAMPLED).astype(int))
        variance, bends = np.zeros((len(chosen), size)), np.zeros((len(chosen), size))
        for index, position in enumerate(chosen):
            unit = np.zeros((factor.shape[1], 2 * size))
            for one in range(size):
                unit[position * size + one, one] = 1.0
                for side, value in ((-1, 1.0), (0, -2.0), (1, 1.0)):
                    at = min(max(position, 1), positions - 2) + side
                    unit[at * size + one, size + one] = value
            found = (unit * cho_solve_banded((factor, True), unit)).sum(0)
            variance[index], bends[index] = found[:size], found[size:]
        variance[0] = 0.0
        at = np.arange(self.frames)
        every = np.stack([np.interp(at, chosen * self.length, one) for one in variance.T], 1)
        return np.moveaxis(every.reshape(self.frames, -1, 2), 0, 1), bends.mean(0).reshape(-1, 2) / self.length**3

    def _hats(self, window: slice) -> np.ndarray:
        """Return how much each position contributes to the frames of a window, (L, positions): straight lines between them."""
        at = np.arange(window.start, window.stop)[:, None] / self.length
        return np.maximum(0.0, 1.0 - np.abs(at - np.arange((self.frames - 2) // self.length + 2)))

    def _matrix(self) -> np.ndarray:
        """Return the information of the positions as a lower band matrix, (bands, positions n 2)."""
        size, windows = 2 * len(self.powers), self.windows()
        count = (self.frames - 2) // self.length + 2
        bands = np.zeros((size * min(count, WINDOW // self.length + 2), size * count))
        for window, information in zip(windows, self.informations, strict=True):
            first, last = window.start // self.length, min(count, (window.stop - 2) // self.length + 2)
            hats = self._hats(window)[:, first:last]
            flat = information.reshape(len(hats), size, len(hats), size)
            flat = np.einsum("ta,tisj,sb->aibj", hats, flat, hats, optimize=True).reshape((last - first) * size, -1)
            for below in range(min(len(flat), len(bands))):
                start = first * size
                bands[below, start : start + len(flat) - below] += np.diagonal(flat, -below) / min(len(windows), 2)
        return bands

    def _factor(self) -> np.ndarray:
        """Return the Cholesky factor of the matrix with the first position fixed."""
        bands = self._matrix()
        bands[0] += 1e-6 * bands[0].mean()
        bands[0, : 2 * len(self.powers)] += 1e6 * bands[0].max()
        return cholesky_banded(bands, lower=True)

    def _sum(self, paths: np.ndarray, window: slice, task: Callable[..., np.ndarray]) -> np.ndarray:
        """Return the sum over all frequencies of the result of a task in a window."""
        places, numbers = paths[:, window], np.arange(window.start, window.stop)
        alike = np.exp(-self.fading[:, None, None] * (numbers[:, None] - numbers) ** 2.0).astype(np.float32)

        def part(first: int) -> np.ndarray:
            some = slice(first, first + PART)
            turned = [np.exp(-1j * self.turns[some] @ place.T).astype(np.complex64) for place in places]
            patterns = [
                power[some, None, None] * share * one[:, :, None] * one.conj()[:, None]
                for power, share, one in zip(self.powers, alike, turned, strict=True)
            ]
            covariance = np.sum(patterns, 0)
            diagonal = np.arange(len(numbers))
            covariance[:, diagonal, diagonal] += self.noise[some, None]
            return task(self, some, window, patterns, np.linalg.inv(covariance))

        return np.sum(on_all_cores(part, range(0, len(self.counts), PART)), 0)


def _score(of: Normal, some: slice, window: slice, patterns: list[np.ndarray], inverse: np.ndarray) -> np.ndarray:
    """Return the slope of the log-likelihood with the positions, (L, n, 2), from some frequencies."""
    likely = (inverse @ of.values[some, window, None])[..., 0]
    weight = (of.counts[some, None] * of.turns[some]).T
    slopes = [
        weight @ (np.einsum("ktu,kut->kt", one, inverse) - (one @ likely[..., None])[..., 0] * likely.conj()).imag
        for one in patterns
    ]
    return -2.0 * np.moveaxis(np.stack(slopes), 2, 0)


def _information(of: Normal, some: slice, _: slice, patterns: list[np.ndarray], inverse: np.ndarray) -> np.ndarray:
    """Return the Fisher information of the positions, (L, n, 2, L, n, 2), from some frequencies."""
    turns, side, count = of.turns[some], inverse.shape[1], len(patterns)
    found = np.empty((side, count, 2, side, count, 2))
    products = [one @ inverse for one in patterns]
    for one in range(count):
        for other in range(one, count):
            both = products[one] @ patterns[other] * np.swapaxes(inverse, 1, 2)
            both -= products[one] * np.swapaxes(products[other], 1, 2)
            flat = both.real.reshape(len(turns), -1)
            for axis, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
                weight = 2.0 * of.counts[some] * turns[:, axis] * turns[:, across]
                block = (weight @ flat).reshape(side, side)
                found[:, one, axis, :, other, across] = block
                found[:, other, across, :, one, axis] = block.T
    return found
