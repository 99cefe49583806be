"""From a noisy autocorrelation estimate to the Fourier modulus that phase retrieval starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from correlograph.lags import LAG_SIDE, LAGS, OBJECT_SIDE
from radiometry.noise.level import HALF_PLANE, RING, NoiseLevel, extrapolated_peak, fill_zero_lag, read_noise_level

GRID = 128
"""Retrieval grid: the 127 x 127 lags of a 64 x 64 object fit without wrapping."""

RESOLUTION_LAGS = 0.5
"""Standard deviation, in lags, of the Gaussian that limits the resolution of a noisy reconstruction."""

RESOLVED_ERROR = 0.01
"""Relative error of the estimate above which noise is guarded against in full; below, in proportion."""


DETECTION_LIMIT = 6.0
"""Standard deviations above the floor below which no object is claimed."""


@dataclass(frozen=True)
class Measurement:
    """An estimate with what was read from it.

    Attributes:
        estimate: (127, 127) float32, zero lag at [63, 63], lines through zero lag interpolated.
        noise: floor, degrees of freedom, ring where the signal ends.
        peak: (r*r)(0) above the floor, patch window deconvolved; 0 where no object is found.
        peak_error: its standard error.
        detection: how many standard deviations the signal stands above the floor (all lags together).
        interpolated: names of lines through zero lag that were replaced ("row", "column").
    """

    estimate: np.ndarray
    noise: NoiseLevel
    peak: float
    peak_error: float
    detection: float
    interpolated: tuple[str, ...]

    @property
    def detectable(self) -> bool:
        """Whether it shows enough for a retrieval to begin."""
        return self.detection >= DETECTION_LIMIT and self.peak > 0.0

    @property
    def box(self) -> int:
        """Side of a square that holds the object: r*r that ends at a ring is that of one as wide as its radius, plus one."""
        return min(OBJECT_SIDE, self.noise.signal_ring + 3)

    @property
    def floor_over_peak(self) -> float | None:
        return self.noise.floor / self.peak if self.peak > 0.0 else None

    @property
    def floor_over_peak_error(self) -> float | None:
        """Standard error of `floor_over_peak`."""
        return self.noise.floor * self.peak_error / self.peak**2 if self.peak > 0.0 else None


SLOPE_WEIGHT = 1.5
"""A signal must stand out of a sloping floor as well, by two thirds of what it must out of a flat one."""


def read_measurement(estimate: np.ndarray, quantisation: float = 0.0, transfer: np.ndarray | None = None) -> Measurement:
    """Read the noise level, interpolate read-noise lines and fill zero lag of a raw estimate (127, 127).

    Args:
        transfer: H of the camera per lag (127, 127) where it is known; the signal is divided by it.
    """
    noise = read_noise_level(estimate, quantisation)
    interpolated_estimate, interpolated = interpolate_lines(estimate, noise)
    found = detection(interpolated_estimate, noise)
    if transfer is not None:
        # Beyond the signal there is nothing to restore, only noise to raise.
        usable = np.where(noise.signal_ring >= RING, np.maximum(transfer, 0.05), 1.0)
        interpolated_estimate = noise.floor + (interpolated_estimate - np.float32(noise.floor)) / usable.astype(np.float32)
    peak, peak_error = extrapolated_peak(interpolated_estimate, noise)
    return Measurement(fill_zero_lag(interpolated_estimate, noise.floor + peak), noise, peak, peak_error, found, interpolated)


def interpolate_lines(estimate: np.ndarray, noise: NoiseLevel) -> tuple[np.ndarray, tuple[str, ...]]:
    """Replace the row or column through zero lag by its neighbours' mean where its outer part stands out.

    Read noise that whole sensor rows (or columns) share is white along them, so it fills exactly
    that line of the power spectrum. Signal that leaks along an axis has a cusp there too, but fills
    the lines beside it, so a line is judged against what these extrapolate to.
    """
    interpolated = np.array(estimate, np.float32)
    names = []
    outside = np.abs(np.arange(-LAGS, LAGS + 1)) > noise.signal_ring
    outside[:LAGS] = False
    for name, view in (("row", interpolated), ("column", interpolated.T)):
        beside = 0.5 * (view[LAGS - 1] + view[LAGS + 1])
        next_beside = 0.5 * (view[LAGS - 2] + view[LAGS + 2])
        level = float((2.0 * beside - next_beside)[outside].mean())
        spread = 2.0 * level * (noise.inflation**0.5 / (noise.dof or 1e6) / outside.sum()) ** 0.5
        if view[LAGS, outside].mean() - level > max(5.0 * spread, 0.15 * level):
            view[LAGS] = beside
            names.append(name)
    return interpolated, tuple(names)


def detection(estimate: np.ndarray, noise: NoiseLevel) -> float:
    """Signal strength in standard deviations: the largest of the summed excesses over growing rings.

    A matched filter for blobs of unknown size around zero lag; zero lag itself is left out. The excess is that over the
    floor or, where less, `SLOPE_WEIGHT` times that over a floor a + b r^2 of the lags outside the ring, extrapolated into it.
    """
    if noise.floor <= 0.0:
        return float("inf") if estimate[HALF_PLANE].max() > 0.0 else 0.0
    spread = max(noise.deviation * noise.inflation**0.5, 1e-6 * noise.floor)
    flat, sloping = [], []
    for ring in (2, 4, 8, 16, 32):
        inside, outside = HALF_PLANE & (ring >= RING), HALF_PLANE & (ring < RING)
        count = float(inside.sum())
        flat.append(float((estimate[inside] - noise.floor).sum()) / (spread * count**0.5))
        basis = np.stack([np.ones(int(outside.sum())), RING[outside].astype(np.float64) ** 2], 1)
        total = np.array([count, float((RING[inside].astype(np.float64) ** 2).sum())])
        inverse = np.linalg.inv(basis.T @ basis)
        excess = float(estimate[inside].sum()) - total @ (inverse @ (basis.T @ estimate[outside].astype(np.float64)))
        sloping.append(excess / (spread * (count + total @ inverse @ total) ** 0.5))
    return min(max(flat), SLOPE_WEIGHT * max(sloping))


def estimate_noise(measurement: Measurement) -> float:
    """Relative L2 error that the noise model gives the estimate's signal: sqrt(sum S^2 / K / sum A^2)."""
    if not measurement.noise.dof:
        return 0.0
    kept = measurement.estimate[measurement.noise.signal_ring + 1 >= RING].astype(np.float64)
    signal = ((kept - measurement.noise.floor) ** 2).sum()
    return float(np.sqrt((kept**2).sum() / measurement.noise.dof / signal)) if signal > 0.0 else np.inf


def fourier_modulus(measurement: Measurement) -> torch.Tensor:
    """|F(r)| on the retrieval grid, float32 (128, 65), scaled to 1 at zero frequency.

    Floor subtracted, noisy lags beyond the signal set to zero, patch window deconvolved (dividing the
    spectrum by the triangle it was multiplied with), resolution limited. Zero lag is free in the
    data: its value lifts all frequencies alike. Without noise it is filled so that the least of the
    highest frequencies falls to zero; with noise, so that four fifths of them do, since an object
    has next to nothing there and noise would be read as structure.
    """
    guard = _guard(measurement)
    excess = fill_zero_lag(measurement.estimate - np.float32(measurement.noise.floor), 0.0)
    if measurement.noise.dof:  # without noise even what leaks beyond the signal is worth keeping
        excess[measurement.noise.signal_ring + 1 < RING] = 0.0
    spectrum = _power(excess)
    spectrum -= np.quantile(spectrum[(_ROW > 0.3) & (_COLUMN > 0.3)], 0.8 * guard)
    return _modulus(spectrum, guard)


def denoised_modulus(signal: np.ndarray, measurement: Measurement) -> torch.Tensor:
    """|F(r)| as `fourier_modulus` gives it, from the signal (127, 127) that a network found in a measurement.

    It holds neither floor nor noise, and zero lag, too.
    """
    return _modulus(_power(signal), _guard(measurement))


_ROW = np.abs(np.fft.fftfreq(GRID))[:, None]
_COLUMN = np.fft.rfftfreq(GRID)[None, :]
"""Cycles per lag of the retrieval grid's spectrum."""


def _guard(measurement: Measurement) -> float:
    """How far noise has to be guarded against, 0 to 1."""
    return min(1.0, estimate_noise(measurement) / RESOLVED_ERROR)


def _power(lags: np.ndarray) -> np.ndarray:
    """Spectrum of centro-symmetric lags (127, 127), (128, 65)."""
    padded = np.zeros((GRID, GRID), np.float32)
    padded[:LAG_SIDE, :LAG_SIDE] = lags
    return np.fft.rfft2(np.roll(padded, (-LAGS, -LAGS), (0, 1))).real


def _modulus(power: np.ndarray, guard: float) -> torch.Tensor:
    """Patch window deconvolved, resolution limited, root taken, 1 at zero frequency; `power` is used up."""
    power /= (1.0 - _ROW) * (1.0 - _COLUMN)
    power *= np.exp(-((2.0 * np.pi * guard * RESOLUTION_LAGS) ** 2) * (_ROW**2 + _COLUMN**2))
    modulus = np.sqrt(np.maximum(power, 0.0))
    scale = modulus[0, 0] or modulus.max() or 1.0
    return torch.from_numpy((modulus / scale).astype(np.float32))
