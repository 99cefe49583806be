"""Patterns of several objects: what each contributes to the spectrum of a frame.

The spectrum of a frame is the sum of the objects' patterns, each with the phase of its displacement, and noise. Over the frames in which
the patterns stay the same, every frequency gives a small linear system for them. Frequencies at which the objects have hardly moved apart
do not tell them from one another; the noise limits what is attributed there.
"""

from __future__ import annotations

import numpy as np

from invert.tracking.follow import likeness, reach_of
from invert.tracking.shifts import move_back
from invert.tracking.spectra import Band

CHANGING_SHARE = 0.1
"""Share of a pattern that is taken as noise when patterns are told from one another."""


def isolate(spectra: np.ndarray, band: Band, paths: list[np.ndarray]) -> list[np.ndarray]:
    """Return, for each object, the spectra (n, R, C) without the patterns of all others.

    Args:
        paths: positions of the objects, (n, 2) each, the brightest first.
    """
    if len(paths) == 1:
        return [spectra]
    left, reach = [spectra.copy() for _ in paths], reach_of(likeness(move_back(spectra, band, paths[0]), band))
    for block in np.array_split(np.arange(len(spectra)), max(1, round(len(spectra) / (2 * reach + 1)))):
        around = np.arange(max(0, block[0] - reach // 2), min(len(spectra), block[-1] + reach // 2 + 1))
        patterns = _patterns(spectra[around], band, [path[around] for path in paths])
        for index, path in enumerate(paths):
            light = move_back(np.broadcast_to(patterns[index], spectra[block].shape), band, -path[block])
            for other in range(len(paths)):
                if other != index:
                    left[other][block] -= light
    return left


def _patterns(spectra: np.ndarray, band: Band, paths: list[np.ndarray]) -> np.ndarray:
    """Return the pattern of each object, (objects, R, C), at the origin of its path."""
    moved = np.stack([move_back(spectra, band, path).sum(0) for path in paths], -1)
    ones = np.ones((len(spectra), len(band.rows), len(band.columns)), np.complex64)
    apart = [[move_back(ones, band, one - other).sum(0) for other in paths] for one in paths]
    # Of each pattern, a share of `CHANGING_SHARE` is new from frame to frame.
    noise = (band.floor + CHANGING_SHARE * band.signal) / np.maximum(band.signal / len(paths), 1e-3 * band.floor)
    system = np.moveaxis(np.array(apart), (0, 1), (-2, -1)) + noise[..., None, None] * np.eye(len(paths))
    return np.moveaxis(np.linalg.solve(system, moved[..., None])[..., 0], -1, 0).astype(np.complex64)
