"""Error of the paths of several objects whose interference overlaps with them.

The model of interference is that of Gaussian objects, so that others draw paths by more than the noise says. Frames so far apart that two
objects have parted show each at a maximum of its own cross-correlation. What is left of the others displaces it, at each distance of frames
by another offset, of up to the radius of a grain; if the path is right, these offsets are about zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invert.tracking.band import Band
from invert.tracking.central_lobe import central_lobe
from invert.tracking.follow import Followed
from invert.tracking.joint import MIN_APART_GRAINS
from invert.tracking.light import at_equal_light
from invert.tracking.shifts import move_back, refine, weight_of
from invert.tracking.start import way_apart


def add_drawn(spectra: np.ndarray, band: Band, followed: Sequence[Followed]) -> list[Followed]:
    """Return several objects with the errors by interference in those of their paths, from spectra (frames, R, C)."""
    if central_lobe(band) is not band:
        return list(followed)
    spectra, found = at_equal_light(spectra, band), []
    for number, one in enumerate(followed):
        others = [other.path for index, other in enumerate(followed) if index != number]
        drawn = np.arange(len(spectra))[:, None] * drawn_per_frame(spectra, band, one, others)
        found.append(replace(one, error=np.hypot(one.error, drawn)))
    return found


def drawn_per_frame(spectra: np.ndarray, band: Band, one: Followed, others: Sequence[np.ndarray]) -> np.ndarray:
    """Return the rms velocity by which maxima of the cross-correlations of distant frames lie beside a path, (2,) pixels per frame; zero
    without frames that are far enough apart from those of other paths (frames, 2)."""
    moved, weight = move_back(spectra, band, one.path), weight_of(band, 0.0)
    squares, total = np.zeros(2), 0.0
    for lag, share in enumerate(one.in_common[: len(spectra) - 1], 1):
        if share > 0.0 and all(way_apart(one.path, other, lag) >= MIN_APART_GRAINS * band.grain_pixels for other in others):
            cross = np.vecdot(moved[:-lag], moved[lag:], axis=0)[None]
            beside, _ = refine(cross, band, weight, np.zeros(2), np.ones(1))
            squares += share * np.minimum(np.abs(beside), band.grain_pixels) ** 2
            total += share * lag**2
    return np.sqrt(squares / max(total, 1e-300))
