"""Displacement of the speckle between two frames: the maximum of their weighted cross-correlation.

An object that moves by u across the line of sight, lit by a laser at rest, moves its speckle over the wall by u (1 + z / d1); d1 is its
distance from the laser spot, z that from the wall (`radiometry/motion.py`). Frames n and n + t then share the speckle, shifted, and have
independent noise. With a power spectrum S of the speckle and a noise floor b, the weight S / (S + b)^2 of the cross-spectrum gives the
maximum-likelihood shift of Gaussian signals in white noise (Knapp and Carter, doi:10.1109/TASSP.1976.1162830, with the small-signal limit
of their processor).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import label, uniform_filter

WINDOWS = (9, 27, 81)
"""Sides of the window, in frequencies, over which the mean power spectrum is smoothed; the smallest that shows the speckle is used."""

OUTER = 0.75
"""The noise floor is the median power beyond this fraction of the highest frequency."""

SIGNAL_SIGMA = 3.0
"""Significance, in standard deviations, above which a frequency counts as signal."""

NEAR_PIXELS = 24
"""Half side of the region around a maximum that is left out of the noise of a cross-correlation."""


@dataclass(frozen=True)
class Shift:
    """Displacement between two frames in pixels (rows, columns), with standard errors.

    Attributes:
        significance: height of the maximum of the cross-correlation in standard deviations of its noise.
    """

    pixels: np.ndarray
    error: np.ndarray
    significance: float


def weights_of(power: torch.Tensor, frames: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the weights of cross-spectra, (rows, columns // 2 + 1), and the power of the speckle, from the mean power spectrum of a
    number of frames without their means; zero outside the region around zero frequency in which the speckle exceeds the noise floor
    significantly.
    """
    rows, columns = power.shape[0], power.shape[1]
    radius = torch.hypot(torch.fft.fftfreq(rows)[:, None], torch.linspace(0.0, 0.5, columns)[None]) / 0.5
    for window in WINDOWS:
        smooth = torch.from_numpy(uniform_filter(power.numpy().astype(np.float64), window, mode="wrap"))
        floor = float(smooth[(radius > OUTER) & (radius <= 1.0)].median())
        excess = smooth - floor
        is_signal = excess > SIGNAL_SIGMA * floor / (frames * window**2) ** 0.5  # of exponential variables
        # Noise exceeds the limit here and there at high frequencies, which would make the maximum falsely sharp.
        regions, _ = label(np.roll(is_signal.numpy(), rows // 2, 0))
        if middle := regions[rows // 2, 0]:
            signal = torch.where(torch.from_numpy(np.roll(regions == middle, -(rows // 2), 0)), excess, 0.0)
            signal[0, 0] = 0.0
            return (signal / (signal + floor).square()).float(), signal.float()
    return torch.zeros((rows, columns)), torch.zeros((rows, columns))


def spectrum_of(frame: np.ndarray, binning: int) -> torch.Tensor:
    """Return the spectrum (rows, columns // 2 + 1) of a frame without its mean; `binning` x `binning` pixels are added first."""
    image = torch.as_tensor(np.ascontiguousarray(frame, np.float32))
    if binning > 1:
        image = torch.nn.functional.avg_pool2d(image[None], binning)[0]
    return torch.fft.rfft2(image - image.mean())


def cross_correlation(cross: torch.Tensor, weights: torch.Tensor, shape: tuple[int, int]) -> np.ndarray:
    """Return the weighted cross-correlation (rows, columns) of a cross-spectrum, zero shift at [0, 0]."""
    return torch.fft.irfft2(cross * weights, s=shape).numpy().astype(np.float64)


def find_shift(correlation: np.ndarray, near: np.ndarray | None = None, reach: int = 0) -> Shift:
    """Return the shift at the maximum of a cross-correlation.

    Args:
        near: shift (rows, columns) around which the maximum is searched, up to `reach` pixels away; None for all shifts.

    The slope of noise at the maximum moves it by slope / curvature. The mean square slope is measured away from the maximum.
    """
    shape = np.array(correlation.shape)
    if near is None:
        peak = np.array(np.unravel_index(int(correlation.argmax()), correlation.shape))
    else:
        offsets = np.arange(-reach, reach + 1)
        rows, columns = ((round(float(centre)) + offsets) % side for centre, side in zip(near, shape, strict=True))
        part = correlation[np.ix_(rows, columns)]
        row, column = np.unravel_index(int(part.argmax()), part.shape)
        peak = np.array((rows[row], columns[column]))
    signed = (peak + shape // 2) % shape - shape // 2
    around = np.roll(correlation, tuple(NEAR_PIXELS - peak), (0, 1))
    far = around[2 * NEAR_PIXELS + 1 :, 2 * NEAR_PIXELS + 1 :]
    around = around - far.mean()
    finer, errors = [], []
    for axis in (0, 1):
        line = (
            around[NEAR_PIXELS - 1 : NEAR_PIXELS + 2, NEAR_PIXELS]
            if axis == 0
            else around[NEAR_PIXELS, NEAR_PIXELS - 1 : NEAR_PIXELS + 2]
        )
        # Frames that are shifted by d share 1 - |d| / side of their pixels, which would draw the maximum towards zero.
        before, here, after = line / (1.0 - np.abs(signed[axis] + np.arange(-1, 2)) / shape[axis])
        curvature = max(2.0 * here - before - after, 1e-300)
        slope = 0.5 * (np.roll(far, -1, axis) - np.roll(far, 1, axis))
        finer.append(float(np.clip(0.5 * (after - before) / curvature, -1.0, 1.0)))
        errors.append(float(slope[1:-1, 1:-1].std() / curvature))
    significance = around[NEAR_PIXELS, NEAR_PIXELS] / max(far.std(), 1e-300)
    return Shift(signed + np.array(finer), np.array(errors), float(significance))
