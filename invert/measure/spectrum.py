"""Measurement: noise level, detection and Fourier modulus of a noisy autocorrelation estimate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from correlograph.lags import LagGrid, lag_grid_of
from radiometry.noise.detection import DETECTION_LIMIT, detection
from radiometry.noise.measured_noise import NoiseLevel, extrapolated_peak, fill_zero_lag, read_noise_level

RESOLUTION_LAGS = 0.5
"""Standard deviation, in lags, of the Gaussian that limits the resolution of a noisy reconstruction."""

RESOLVED_ERROR = 0.01
"""Relative error of the estimate above which the regularisation is complete; below it, its strength is proportional."""


@dataclass(frozen=True)
class Measurement:
    """An estimate with its noise level and signal.

    Attributes:
        values: (127, 127) float32, zero lag at [63, 63], lines through zero lag interpolated.
        noise: floor, degrees of freedom, and radius in lags beyond which no signal is detected.
        peak: (r*r)(0) above the floor, patch window deconvolved; 0 without an object.
        peak_error: its standard error.
        detection: significance of the signal above the floor in standard deviations, over all lags.
        interpolated: names of the lines through zero lag that were replaced ("row", "column").
    """

    values: np.ndarray
    noise: NoiseLevel
    peak: float
    peak_error: float
    detection: float
    interpolated: tuple[str, ...]

    @property
    def lag_grid(self) -> LagGrid:
        """Lags of the estimate."""
        return lag_grid_of(self.values)

    @property
    def detectable(self) -> bool:
        """Whether the signal suffices for a reconstruction."""
        return self.detection >= DETECTION_LIMIT and self.peak > 0.0

    @property
    def box(self) -> int:
        """Side of a square support from the signal extent: an object is as wide as the radius of its r*r plus one."""
        return min(self.lag_grid.object_side, self.noise.signal_ring + 3)

    @property
    def floor_over_peak(self) -> float | None:
        return self.noise.floor / self.peak if self.peak > 0.0 else None

    @property
    def floor_over_peak_error(self) -> float | None:
        """Standard error of `floor_over_peak`."""
        return self.noise.floor * self.peak_error / self.peak**2 if self.peak > 0.0 else None


def read_measurement(estimate: np.ndarray, quantisation: float = 0.0, transfer: np.ndarray | None = None) -> Measurement:
    """Read the noise level of an estimate (127, 127), interpolate lines of read noise and fill zero lag.

    Args:
        transfer: H of the camera per lag (127, 127), if it is known; the signal is divided by it.
    """
    noise = read_noise_level(estimate, quantisation)
    interpolated_estimate, interpolated = interpolate_lines(estimate, noise)
    found = detection(interpolated_estimate, noise)
    if transfer is not None:
        # beyond the signal, division by H would only amplify noise
        usable = np.where(noise.signal_ring >= lag_grid_of(estimate).ring, np.maximum(transfer, 0.05), 1.0)
        interpolated_estimate = noise.floor + (interpolated_estimate - np.float32(noise.floor)) / usable.astype(np.float32)
    peak, peak_error = extrapolated_peak(interpolated_estimate, noise)
    return Measurement(fill_zero_lag(interpolated_estimate, noise.floor + peak), noise, peak, peak_error, found, interpolated)


def interpolate_lines(estimate: np.ndarray, noise: NoiseLevel) -> tuple[np.ndarray, tuple[str, ...]]:
    """Replace the row or column through zero lag by the mean of its neighbours if its outer part exceeds them.

    Read noise that whole sensor rows (or columns) share is white along them, so it fills exactly that line of the power spectrum.
    Signal that leaks along an axis has a cusp there too, but fills the neighbouring lines as well. A line is therefore compared with
    the value that its neighbours extrapolate to.
    """
    interpolated = np.array(estimate, np.float32)
    names = []
    grid = lag_grid_of(estimate)
    middle = grid.lags
    outside = np.abs(grid.steps) > noise.signal_ring
    outside[:middle] = False
    for name, view in (("row", interpolated), ("column", interpolated.T)):
        beside = 0.5 * (view[middle - 1] + view[middle + 1])
        next_beside = 0.5 * (view[middle - 2] + view[middle + 2])
        level = float((2.0 * beside - next_beside)[outside].mean())
        spread = 2.0 * level * (noise.inflation**0.5 / (noise.dof or 1e6) / outside.sum()) ** 0.5
        if view[middle, outside].mean() - level > max(5.0 * spread, 0.15 * level):
            view[middle] = beside
            names.append(name)
    return interpolated, tuple(names)


def estimate_noise(measurement: Measurement) -> float:
    """Return the relative L2 error of the estimate's signal under the noise model: sqrt(sum S^2 / K / sum A^2)."""
    if not measurement.noise.dof:
        return 0.0
    kept = measurement.values[measurement.noise.signal_ring + 1 >= measurement.lag_grid.ring].astype(np.float64)
    signal = ((kept - measurement.noise.floor) ** 2).sum()
    return float(np.sqrt((kept**2).sum() / measurement.noise.dof / signal)) if signal > 0.0 else np.inf


def fourier_modulus(measurement: Measurement) -> torch.Tensor:
    """Return |F(r)| on the padded grid of the lags, float32 (128, 65), scaled to 1 at zero frequency.

    The floor is subtracted, noisy lags beyond the signal are set to zero, the patch window is deconvolved (by division of the
    spectrum by its triangle), and the resolution is limited. Zero lag is a free parameter that adds a constant to the power
    spectrum. Without noise, the constant makes the minimum over the highest frequencies zero; with noise, it removes the power of
    four fifths of them, because an object has almost no power there and noise would appear as structure.
    """
    guard = _guard(measurement)
    excess = fill_zero_lag(measurement.values - np.float32(measurement.noise.floor), 0.0)
    if measurement.noise.dof:  # without noise, leakage beyond the signal is useful
        excess[measurement.noise.signal_ring + 1 < measurement.lag_grid.ring] = 0.0
    spectrum = _power(excess)
    row, column = _frequencies(len(spectrum))
    spectrum -= np.quantile(spectrum[(row > 0.3) & (column > 0.3)], 0.8 * guard)
    return _modulus(spectrum, guard)


def denoised_modulus(signal: np.ndarray, measurement: Measurement) -> torch.Tensor:
    """Return |F(r)| like `fourier_modulus`, from the denoised signal (127, 127) of a measurement, which includes zero lag."""
    return _modulus(_power(signal), _guard(measurement))


@lru_cache(maxsize=4)
def _frequencies(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the row and column frequencies, in cycles per lag, of a spectrum on a periodic grid."""
    return np.abs(np.fft.fftfreq(side))[:, None], np.fft.rfftfreq(side)[None, :]


def _guard(measurement: Measurement) -> float:
    """Return the regularisation strength, 0 without noise to 1; it sets the subtracted spectral floor and the low-pass filter."""
    return min(1.0, estimate_noise(measurement) / RESOLVED_ERROR)


def _power(lags: np.ndarray) -> np.ndarray:
    """Return the spectrum (128, 65) of centro-symmetric lags (127, 127)."""
    grid = lag_grid_of(lags)
    padded = np.zeros((grid.padded_side, grid.padded_side), np.float32)
    padded[: grid.side, : grid.side] = lags
    return np.fft.rfft2(np.roll(padded, (-grid.lags, -grid.lags), (0, 1))).real


def _modulus(power: np.ndarray, guard: float) -> torch.Tensor:
    """Deconvolve the patch window, limit the resolution, and take the root, 1 at zero frequency; `power` is overwritten."""
    row, column = _frequencies(len(power))
    power /= (1.0 - row) * (1.0 - column)
    power *= np.exp(-((2.0 * np.pi * guard * RESOLUTION_LAGS) ** 2) * (row**2 + column**2))
    modulus = np.sqrt(np.maximum(power, 0.0))
    scale = modulus[0, 0] or modulus.max() or 1.0
    return torch.from_numpy((modulus / scale).astype(np.float32))
