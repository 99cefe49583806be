"""Error of the paths of several objects whose interference overlaps with them.

The model of interference is that of Gaussian objects, so that others draw paths by more than the noise says. Frames so far apart that two
objects have parted show each at a maximum of its own cross-correlation. What is left of the others displaces it, at each distance of frames
by another offset, of up to the radius of a grain; if the path is right, these offsets are about zero.
"""

from __future__ import annotations

import numpy as np

from invert.tracking.band import Band
from invert.tracking.shifts import move_back, refine, weight_of
from invert.tracking.start import way_apart


def drawn_per_frame(
    spectra: np.ndarray, band: Band, paths: np.ndarray, in_common: np.ndarray, least_apart: float
) -> np.ndarray:
    """Return the rms velocity by which maxima of the cross-correlations of distant frames lie beside each path, (n, 2) pixels per frame;
    zero without such frames.

    Args:
        spectra: (frames, R, C).
        paths: (n, frames, 2).
        in_common: share of the power of the speckle that frames 1, 2, ... apart have in common by each object, (n, distances).
        least_apart: way by which objects have parted, in pixels.
    """
    found, weight = np.zeros((len(paths), 2)), weight_of(band, 0.0)
    for number, (path, shares) in enumerate(zip(paths, in_common, strict=True)):
        others, total, moved = np.delete(paths, number, 0), 0.0, move_back(spectra, band, path)
        for lag, share in enumerate(shares[: len(path) - 1], 1):
            if share > 0.0 and all(way_apart(path, other, lag) >= least_apart for other in others):
                cross = (moved[:-lag].conj() * moved[lag:]).sum(0)[None]
                beside, _ = refine(cross, band, weight, np.zeros(2), np.array([float(lag)]))
                found[number] += share * np.minimum(np.abs(lag * beside), band.grain_pixels) ** 2
                total += share * lag**2
        found[number] = np.sqrt(found[number] / max(total, 1e-300))
    return found
