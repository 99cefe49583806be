"""Frequencies of the speckle of objects, without those of their interference.

The power of the speckle of an object is the autocorrelation of its albedo, which is largest at zero frequency. The interference of two is
their cross-correlation, centred at the difference of their places. It moves as neither of them does. Its phase is that between their light,
and new in every frame if one of them vibrates by part of a wavelength.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter, label
from skimage.morphology import h_maxima
from skimage.segmentation import watershed

from invert.tracking.band import Band
from invert.tracking.spectra import SLOW_PERIODS

VALLEY, SMOOTHING = 1.5, 1.5
"""Least height of a lobe of the power over the valley between it and the centre, and rms width in frequencies to which the power is
smoothed before lobes are sought."""

MIN_POWER, MAX_POWER = 0.1, 0.8
"""Least and largest share of the power of the speckle in its central lobe. Equal objects have one over their number there; a second object
of an eighth of the power of the first (`several.MIN_RELATIVE_POWER`) leaves 0.62, if the band shows all of their interference apart."""

FLOOR = 1e-6
"""Power over its maximum below which it counts as none."""


def central_lobe(band: Band) -> Band:
    """Return a band without the lobes of the power that valleys part from zero frequency; the band itself if they hold less than a fifth of
    the power, which is too little for the interference of objects, or if noise hides them."""
    if band.is_dim:
        return band
    zero = int(np.argmin(np.abs(band.rows)))
    reach = min(zero, len(band.rows) - 1 - zero)
    rows, middle = slice(zero - reach, zero + reach + 1), (reach, len(band.columns) - 1)
    power, inside = (_smooth_plane(one[rows]) for one in (band.signal, (band.counts > 0.0).astype(np.float64)))
    power /= np.maximum(inside, 1e-3)
    periods = np.hypot(*np.ogrid[-middle[0] : middle[0] + 1, -middle[1] : middle[1] + 1])
    power[periods <= SLOW_PERIODS] = 2.0 * VALLEY * power.max()  # left out of the band; no other maximum is as high
    heights = np.log(np.maximum(power, FLOOR * power.max()))
    lobes = watershed(-heights, label(h_maxima(heights, np.log(VALLEY)))[0])
    is_central = np.zeros(band.counts.shape, bool)
    is_central[rows] = (lobes == lobes[middle])[:, middle[1] :]
    central = replace(band, counts=np.where(is_central, band.counts, 0.0))
    return central if MIN_POWER < central.power / band.power < MAX_POWER else band


def _smooth_plane(values: np.ndarray) -> np.ndarray:
    """Return values (2 r + 1, C) at columns of zero or more, and at their opposites, (2 r + 1, 2 C - 1), smoothed."""
    return gaussian_filter(np.concatenate([values[::-1, :0:-1], values], 1), SMOOTHING)
