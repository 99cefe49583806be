"""Light of each frame, which the laser or the exposure may change."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from invert.tracking.band import Band
from invert.tracking.parts import sum_over_rows

FALSE_ALARM = 0.01
"""Probability that noise alone looks like light that changes from frame to frame."""

MAX_LIGHT_NOISE = 0.25
"""Variance of the light that is measured in one frame, over its square, above which it is taken to be the same in all."""

MAX_POWER_RATIO = 2.0
"""Ratio of the powers of frames up to which they count as even."""

MIN_LIGHT = 1e-3
"""Least amplitude of the speckle in a frame over the usual one."""


def light_of_frames(spectra: np.ndarray, band: Band) -> np.ndarray:
    """Return the amplitude of the speckle in each frame, (frames,), over that of the band, if its changes are no noise.

    The weights leave out white noise, because the number of photons in a frame is random, too.
    """
    total = np.maximum(band.signal + band.floor, 1e-150)
    of_signal, of_noise = (np.where(band.counts > 0.0, band.counts * one / total**2, 0.0) for one in (band.signal, 1.0))
    weights = of_signal - of_noise * of_signal.sum() / of_noise.sum()
    full = float((weights * total).sum())
    if full <= 0.0:  # speckle that looks like the floor
        return np.ones(len(spectra))
    found, variances = weighted_powers(spectra, weights)
    found, own_noise = found / full, band.noise_gain * variances / full**2
    noise = 2.0 * band.noise_gain * (weights**2 / np.maximum(band.counts, 1.0) * total**2).sum() / full**2
    variance, noisy = float(found.var(ddof=1)), chi2.isf(FALSE_ALARM, len(found) - 1) / (len(found) - 1)
    if noise > MAX_LIGHT_NOISE or variance < noise * noisy:
        return np.ones(len(found))
    usual = max(float(np.median(found)), MIN_LIGHT**2)
    kept = np.maximum(1.0 - own_noise / variance, 0.0)
    # A registration that takes a frame for less than half as bright as it is does not converge.
    least = np.maximum(own_noise**0.5, MIN_LIGHT**2 * usual)
    return np.sqrt(np.maximum(usual + kept * (found - usual), least))


def at_equal_light(spectra: np.ndarray, band: Band) -> np.ndarray:
    """Return spectra (frames, R, C) as if all frames had the light of the band; the noise of darker ones grows."""
    light = light_of_frames(spectra, band).astype(np.float32)
    return spectra if (light == 1.0).all() else spectra / light[:, None, None]


def at_even_power(spectra: np.ndarray, band: Band) -> np.ndarray:
    """Return spectra (frames, R, C) as if speckle and noise together had the same power in all frames, that of the band.

    What two frames share then is as significant as its height, however bright they are.
    """
    power = np.maximum(weighted_powers(spectra, band.whitening)[0] / band.counts.sum(), 1e-30)
    if power.max() < MAX_POWER_RATIO * power.min():
        return spectra
    return spectra / np.sqrt(power).astype(np.float32)[:, None, None]


def weighted_powers(spectra: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted sums of the powers of spectra (n, R, C), and their variances if the powers are exponential variables, (2, n)."""

    def sums(rows: slice) -> np.ndarray:
        weighted = np.abs(spectra[:, rows]) ** 2 * weights[rows].astype(np.float32)
        return np.stack([weighted.sum((1, 2), np.float64), 0.5 * (weighted**2).sum((1, 2), np.float64)])

    return sum_over_rows(sums, spectra)
