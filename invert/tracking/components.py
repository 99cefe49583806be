"""Power and fading of the speckle of several objects, from frames in which all of them move."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.ndimage import uniform_filter

from invert.tracking.band import Band
from invert.tracking.parts import on_all_cores
from invert.tracking.shifts import move_back
from invert.tracking.spectra import SMOOTHING
from invert.tracking.start import are_apart

MAX_LAG, LAGS = 16, 6
"""Largest distance of frames, and number of distances, at which powers are measured."""

RIDGE = 0.01
"""Regularisation that keeps the equations of objects solvable at frequencies at which they have not moved apart; the same power then
goes to each."""

MIN_FADED = 0.2
"""Least share of what frames of the least distance have in common that the fading is measured from."""


@dataclass(frozen=True)
class Components:
    """Components of the speckle of frames.

    Attributes:
        powers: power spectrum of each object, (n, R, C).
        noise: power of all else, interference included, (R, C).
        fading: frames k apart have exp(-fading k^2) of the speckle of an object in common, (n,); NaN where they have too little in
            common to tell.
    """

    powers: np.ndarray
    noise: np.ndarray
    fading: np.ndarray

    def in_common(self, band: Band, frames: int) -> np.ndarray:
        """Return the share of the power of all speckle that frames 1, 2, ... apart have in common by each object, (n, at most 16)."""
        shares = (self.powers * band.counts).sum((1, 2)) / band.power
        return shares[:, None] * np.exp(-np.nan_to_num(self.fading)[:, None] * np.arange(1, min(MAX_LAG + 1, frames)) ** 2.0)


def unmix(spectra: np.ndarray, band: Band, paths: np.ndarray) -> Components:
    """Measure the objects that move along paths (n, frames, 2), from spectra (frames, R, C).

    The mean cross-spectrum of pairs of frames, moved back along the path of an object, is its power and, of each other object, the power
    times the mean of exp(2 pi i f D), where D is its displacement relative to the first. These equations are solved at each frequency.
    """
    lags = _lags(band, paths)
    size = max(1, len(band.rows) // 16)
    parts = on_all_cores(
        lambda first: _common(spectra[:, first : first + size], band.part(slice(first, first + size)), paths, lags),
        range(0, len(band.rows), size),
    )
    common = np.concatenate(parts, 2)  # (lags, n, R, C)
    fading = np.array([_fit_fading(lags, one) for one in (common * band.counts).sum((2, 3)).T])
    left = np.exp(-np.nan_to_num(fading) * lags[:, None] ** 2.0)  # (lags, n)
    powers = _smooth(np.einsum("kn,knrc->nrc", left / (left**2).sum(0), common), band)
    whole = (powers * band.counts).sum((1, 2))
    powers = np.maximum(powers, 0.0)  # which must not turn noise into power
    powers *= np.clip(whole / np.maximum((powers * band.counts).sum((1, 2)), 1e-300), 0.0, 1.0)[:, None, None]
    total = _smooth(np.mean(np.abs(spectra) ** 2, 0, np.float64), band)
    return Components(powers, np.maximum(total - powers.sum(0), band.floor), fading)


def _smooth(power: np.ndarray, band: Band) -> np.ndarray:
    """Return spectra (..., R, C) smoothed within the band, and zero outside."""
    inside = (band.counts > 0.0).astype(np.float64)
    sides = (*(0 for _ in power.shape[:-2]), SMOOTHING[0], SMOOTHING[0])
    weight = uniform_filter(inside, SMOOTHING[0], mode="constant")
    return inside * uniform_filter(power * inside, sides, mode="constant") / np.maximum(weight, 1e-9)


def _lags(band: Band, paths: np.ndarray) -> np.ndarray:
    """Return distances of frames, from that at which all objects have moved apart, if they do."""
    most = min(MAX_LAG, paths.shape[1] - 1)
    moved = (lag for lag in range(1, most) if all(are_apart(*pair, lag, band) for pair in combinations(paths, 2)))
    first = next(moved, max(1, most // 2))
    return np.unique(np.linspace(first, most, LAGS).astype(int))


def _common(spectra: np.ndarray, band: Band, paths: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Return what frames some distances apart have in common by each object, (lags, n, R, C), from some rows of spectra."""
    count, found = len(paths), []
    moved = [move_back(spectra, band, path) for path in paths]
    for lag in lags:
        steps = paths[:, lag:] - paths[:, :-lag]
        seen = np.stack([np.vecdot(one[:-lag], one[lag:], axis=0) / len(steps[0]) for one in moved], -1)
        mixing = np.empty((*seen.shape, count), np.complex128)
        for one in range(count):
            for other in range(count):
                apart = 2j * np.pi * (steps[one] - steps[other])
                rows, columns = np.exp(np.outer(band.rows, apart[:, 0])), np.exp(np.outer(apart[:, 1], band.columns))
                mixing[:, :, one, other] = rows @ columns / len(apart)
        turned = np.conj(np.swapaxes(mixing, -1, -2))
        left = (turned @ mixing).real + RIDGE * np.eye(count)
        found.append(np.moveaxis(np.linalg.solve(left, (turned @ seen[..., None]).real)[..., 0], -1, 0))
    return np.stack(found)


def _fit_fading(lags: np.ndarray, alike: np.ndarray) -> float:
    """Return the fading from likenesses proportional to exp(-fading k^2) of frames at distances k; NaN if fewer than two are clear."""
    clear = alike > MIN_FADED * alike.max()
    if clear.sum() < 2 or alike.max() <= 0.0:
        return np.nan
    return max(0.0, -float(np.polyfit(lags[clear] ** 2.0, np.log(alike[clear]), 1)[0]))
