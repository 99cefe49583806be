"""Light of several objects, told apart by their motion.

Along the path of an object, its own speckle stays the same over some frames, while that of the others passes by. The mean of these frames,
each moved back, is its pattern; what the patterns of the others contribute is subtracted from each frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invert.tracking.band import Band
from invert.tracking.shifts import move_back
from invert.tracking.start import Start

CHANGING_SHARE = 0.1
"""Share of a pattern that is taken as new from frame to frame."""


def subtract_light(spectra: np.ndarray, band: Band, starts: Sequence[Start], size: int) -> np.ndarray:
    """Return spectra (n, R, C) without the light of objects, one subtracted after the other; patterns are means of a number of frames."""
    left = spectra.copy()
    for one in starts:
        left -= _light(left, band, one.path, size)
    return left


def _light(spectra: np.ndarray, band: Band, path: np.ndarray, size: int) -> np.ndarray:
    """Return the contribution of the pattern of an object to each spectrum: the mean of some frames around it, at their places."""
    total = np.zeros((len(spectra) + 1, *spectra.shape[1:]), np.complex64)
    np.cumsum(move_back(spectra, band, path), 0, out=total[1:])
    first = np.clip(np.arange(len(spectra)) - size // 2, 0, len(spectra) - size)
    noise = band.floor / np.maximum(band.signal, 1e-3 * band.floor)
    share = 1.0 / (size * (1.0 + CHANGING_SHARE) + noise)
    return move_back((total[first + size] - total[first]) * share.astype(np.float32), band, -path)
