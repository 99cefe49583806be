"""Steps of an object that moves while the shutter is open.

With a shutter that is open for a share s of the interval, two consecutive exposures hold all distances in time from 1 - s to 1 + s
intervals. Speckle that is closer in time is more alike, so that the step appears shorter. At a spatial frequency whose phase turns by phi
per step, the cross-spectrum of the two frames is

    int_-1^1 (1 - |x|) c(1 + s x) exp(i phi (1 + s x)) dx,    c(t) = (2 J1(q t) / (q t))^2,    q = 2 fading^(1/2),

where c is the likeness of two moments under an evenly lit round spot, which falls like exp(-fading t^2) at first. The phase of the integral
over phi is the factor by which the step appears shorter: 1 - fading s^2 / 3 for small fading and phi.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from invert.tracking.band import Band
from invert.tracking.follow import Followed
from invert.tracking.register import PAIRS, likeness_of_pairs
from invert.tracking.smoothing import smooth
from radiometry.motion import airy

APART = np.linspace(-1.0, 1.0, 65)
"""Points of the integral."""

MAX_FADING = 1.5
"""Largest fading of a step: beyond, the likeness is zero within two exposures."""

MAX_PHASE = 3.0
"""Largest phase within an exposure, in radians: blur by motion leaves little of the frequencies beyond."""

SHUTTER_ERROR = 0.15
"""Relative error of the correction: half of the difference to that for a Gaussian spot."""

MIN_POWER = 0.1
"""Least power of the speckle of a frame, over the mean, that is used."""

ROUNDS = 30


def shortening(fading: np.ndarray, phase: np.ndarray, share: float) -> np.ndarray:
    """Return the factor (n,) by which steps appear shorter, for their fading (n,) and the phase phi (n,), in radians."""
    phase = np.clip(phase, 1e-3, MAX_PHASE / share)
    turned = np.exp(1j * share * phase[:, None] * APART)
    return np.minimum(1.0 + np.angle((_weights(fading, share) * turned).sum(1)) / phase, 1.0)


def _weights(fading: np.ndarray, share: float) -> np.ndarray:
    """Return how often two exposures hold each distance in time, times the likeness there, (n, points)."""
    return (1.0 - np.abs(APART)) * airy(2.0 * np.sqrt(fading)[:, None] * (1.0 + share * APART)) ** 2


def fading_along_steps(spectra: np.ndarray, band: Band, path: np.ndarray, share: float) -> float:
    """Return the mean square of the steps along a path (n, 2) over that of the way in which the likeness falls to 1 / e.

    It is fitted to the likenesses of exposures one and two apart. Fast steps also lower the power of the speckle while the shutter is open.
    """
    chosen = np.unique(np.linspace(0, len(path) - 3, PAIRS).astype(int))
    *alike, power = likeness_of_pairs([(chosen, 1), (chosen, 2), (np.arange(len(path)), 0)], spectra, band, path)
    weight = band.whitening
    power = np.maximum(power - (weight * band.floor).sum() / (weight * band.signal).sum(), MIN_POWER)
    alike, seen = np.concatenate(alike), np.concatenate([np.sqrt(power[chosen] * power[chosen + step]) for step in (1, 2)])
    usual = max(float((np.diff(path, axis=0) ** 2).sum(1).mean()), 1e-12)
    near, far = (((path[chosen + step] - path[chosen]) ** 2).sum(1) / usual for step in (1, 2))

    def misfit(fading: float) -> float:
        # Over two intervals, an exposure is half as long.
        shape = seen * np.concatenate([_weights(fading * near, share).sum(1), _weights(fading * far, 0.5 * share).sum(1)])
        return float(((alike - (alike @ shape) / max(shape @ shape, 1e-300) * shape) ** 2).sum())

    return float(minimize_scalar(misfit, bounds=(0.0, MAX_FADING), method="bounded").x)


def for_open_shutter(found: Followed, band: Band, share: float, gaps: np.ndarray | None = None) -> Followed:
    """Return the path for a shutter that is open for a share of the interval between frames.

    The fading is proportional to the square of the step from frame to frame, where noise leaves these known. As far as a step differs from
    the usual, its correction is part of the error, because the fading is a fit to all steps.

    Args:
        band: band with the power of this object.
        gaps: number of intervals of each step, (frames - 1,); steps over missing frames are left as they are. None for one each.
    """
    if share == 0.0 or found.fading == 0.0:
        return found
    gaps = np.ones(len(found.path) - 1) if gaps is None else gaps
    steps, ways = np.diff(found.path, axis=0), np.diff(smooth(found.path, found.noise), axis=0) / gaps[:, None]
    squares = (ways**2).sum(1)
    squares = squares / max(float(squares.mean()), 1e-12) if found.noise.of_pair.any() else np.ones(len(ways))
    # Weighted by their slopes, frequencies of a Gaussian band act like the one at the root of 3 times their rms.
    phase = 2.0 * np.pi * np.sqrt(3.0 * np.einsum("ni,ij,nj->n", ways, band.mean_squares, ways))
    usual = factor = shortening(np.array([found.fading]), np.array([np.sqrt((phase**2).mean())]), share)
    for _ in range(ROUNDS):
        fading = np.minimum(found.fading * squares * (usual / factor) ** 2, MAX_FADING)
        factor = shortening(fading, phase / factor, share)
    longer = np.where(gaps > 1, 0.0, 1.0 / factor - 1.0)
    # Where a longer step has less and less in common, it appears hardly longer, and what is seen tells it less well.
    parts = longer, SHUTTER_ERROR * longer / np.maximum(2.0 * factor - 1.0, 0.2), longer - (1.0 / usual - 1.0)
    added, *errors = (np.concatenate([np.zeros((1, 2)), np.cumsum(part[:, None] * steps, 0)]) for part in parts)
    error = np.sqrt(found.error**2 + sum(one**2 for one in errors))
    return replace(found, path=found.path + added, error=error, shortened=1.0 - float(factor.min()))
