"""Differences between the autocorrelations of single frames: speckle of one object has none beyond noise.

The power of a frame at a lag is Gamma-distributed with shape K around a_i S + c_i, where S is the mean of all frames; the
factor a_i absorbs the brightness of frame i, and the constant c_i its shot noise. They are fitted with the mean of the
neighbouring lags as instrumental variable, because noise in S would bias an ordinary fit. Photographs of different scenes,
and objects that change between frames, scatter more.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.ndimage import convolve
from scipy.stats import chi2

from radiometry.estimation.autocorrelation_estimator import degrees_of_freedom, spectral_window
from radiometry.estimation.excess_scatter import ExcessScatter
from radiometry.estimation.third_moment import FilteredFrames

MIN_EXPECTATION = 0.1
"""Minimum of the fitted power at a lag in units of its mean."""


def frame_differences(frames: FilteredFrames, used: np.ndarray, inflation: float) -> ExcessScatter | None:
    """Return the scatter between frames of the power at a lag; the brightness and the shot noise of a frame are ignored. None for one
    frame and for less than two lags.

    Args:
        used: mask of the lags, one of each pair, (127, 127).
        inflation: variance inflation of sums over lags.
    """
    count, lags = len(frames.spectra), int(used.sum())
    dof = degrees_of_freedom(1, frames.frame, frames.patch) * (1.0 if frames.kept is None else frames.kept.patterns)
    if count < 2 or lags < 2:
        return None
    power = np.stack([_power_at_lags(frames, spectrum) for spectrum in frames.spectra])
    power /= np.maximum(
        power[:, used].mean(1)[:, None, None], np.finfo(np.float64).tiny
    )  # bright frames count no more than others
    mean, neighbours = power.mean(0), np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]]) / 8.0
    instrument = np.stack((np.ones(lags), convolve(mean, neighbours)[used]))
    power, mean = power[:, used], np.maximum(mean[used], 1e-9)
    terms = np.stack((np.ones(lags), mean))
    weighted = instrument / instrument[1].clip(1e-9) ** 2
    factors = np.linalg.lstsq(weighted @ terms.T, weighted @ power.T, rcond=None)[0]
    expected = np.maximum(factors.T @ terms, MIN_EXPECTATION)
    slopes = factors[1][:, None] / count
    variance = ((1.0 - 2.0 * slopes) * expected**2 + slopes**2 * (expected**2).sum(0)) / dof
    excess = float(((power - factors.T @ terms) ** 2 / np.maximum(variance, 1e-9)).mean())
    independent = (count - 1) * lags / inflation / (1.0 + 3.0 / dof)  # the excess kurtosis of the power is 6 / K
    return ExcessScatter.of(excess / dof, 1.0 / dof, chi2(independent, scale=1.0 / independent))


def _power_at_lags(frames: FilteredFrames, spectrum: torch.Tensor) -> np.ndarray:
    """Return the power of one frame at the lags, (127, 127)."""
    power = spectrum.real.square() + spectrum.imag.square()
    rows, columns = power.shape
    kept = np.r_[: (rows + 1) // 2, frames.padded[0] - rows // 2 : frames.padded[0]]
    down, right = (
        spectral_window(*sizes, frames.lags) for sizes in zip(frames.frame, frames.patch, frames.padded, strict=True)
    )
    down, right = down[:, kept], right[:, :columns].copy()
    right[:, 0] *= 0.5  # column zero holds both halves of the plane
    half = (torch.from_numpy(down).to(power) @ power @ torch.from_numpy(right.T.copy()).to(power)).cpu().numpy()
    return half + half[::-1, ::-1]
