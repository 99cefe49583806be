"""Light of several objects, told apart by their motion.

Along the path of an object, its own speckle stays the same over some frames, while that of the others passes by. The mean of these frames,
each moved back, is its pattern; what the patterns of the others contribute is subtracted from each frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter

from invert.tracking.shifts import move_back
from invert.tracking.spectra import SMOOTHING, Band
from invert.tracking.start import Start

CHANGING_SHARE = 0.1
"""Share of a pattern that is taken as new from frame to frame."""

ROUNDS = 2
"""Rounds in which the pattern of each object is found in what the others leave."""


def subtract_light(spectra: np.ndarray, band: Band, starts: Sequence[Start]) -> np.ndarray:
    """Return spectra (n, R, C) without the light of objects, one subtracted after the other."""
    left = spectra.copy()
    for one in starts:
        left -= _light(left, band, one)
    return left


def isolate(spectra: np.ndarray, band: Band, starts: Sequence[Start]) -> list[tuple[np.ndarray, Band]]:
    """Return, for each object, the spectra (n, R, C) without the light of all others, and their band, in which what is not its own speckle
    counts as noise."""
    if len(starts) == 1:
        return [(spectra, band)]
    lights = [np.zeros_like(spectra) for _ in starts]
    left = spectra.copy()  # without the light of any object
    for _ in range(ROUNDS):
        for index, one in enumerate(starts):
            left += lights[index]
            lights[index] = _light(left, band, one)
            left -= lights[index]
    found = []
    for one, light in zip(starts, lights, strict=True):
        own = left + light
        signal = one.share * band.signal
        power = uniform_filter((np.abs(own) ** 2).mean(0), SMOOTHING[0], mode="nearest")
        found.append((own, replace(band, signal=signal, floor=np.maximum(power - signal, band.floor))))
    return found


def _light(spectra: np.ndarray, band: Band, one: Start) -> np.ndarray:
    """Return the contribution of the pattern of an object to each spectrum: the mean of `lag` frames around it, at their places."""
    size, path = one.lag, one.path
    total = np.zeros((len(spectra) + 1, *spectra.shape[1:]), np.complex64)
    np.cumsum(move_back(spectra, band, path), 0, out=total[1:])
    first = np.clip(np.arange(len(spectra)) - size // 2, 0, len(spectra) - size)
    noise = band.floor / np.maximum(band.signal, 1e-3 * band.floor)
    share = 1.0 / (size * (1.0 + CHANGING_SHARE) + noise)
    return move_back((total[first + size] - total[first]) * share.astype(np.float32), band, -path)
