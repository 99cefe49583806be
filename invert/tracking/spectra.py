"""Spectra of frames in the band of their speckle.

A frame is not periodic. Without a window, the jump between its opposite edges stays at its place while the speckle moves, and draws every
shift towards zero. The window falls to zero at the edges like a cosine, over several grains of the speckle: a steeper edge, which stays at
its place, too, would outweigh the speckle at high frequencies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.fft import fft, fftfreq, irfft2, prev_fast_len, rfft2
from scipy.ndimage import label, uniform_filter, uniform_filter1d
from scipy.signal.windows import tukey
from scipy.stats import gamma

from correlograph.errors import memory_bytes
from invert.tracking.band import TAPER, Band
from invert.tracking.parts import on_all_cores
from radiometry.estimation.hot_pixels import HotPixels

FRAMES_FOR_POWER, DIM_FRAMES_FOR_POWER = 32, 256
"""Number of frames from which the power spectrum is measured, and of those whose speckle is nowhere above the noise."""

SMOOTHING = (9, 27, 81)
"""Sides of the window, in frequencies, over which the mean power spectrum is smoothed; the smallest that shows the speckle is used."""

MAX_BRIGHTNESS = 3.0
"""Light of a frame over the median beyond which it counts less: one bright frame would outweigh all others."""

OUTER = 0.75
"""The noise floor is the median power beyond this fraction of the highest frequency."""

SIGNAL_SIGMA = 3.0
"""Significance, in standard deviations, above which a frequency counts as signal."""

SLOW_PERIODS = 2
"""Frequencies up to this many periods per frame belong to uneven light and are left out; a window mixes as many with their neighbours."""

BYTES_PER_COEFFICIENT = 84
"""Measured memory per frame and coefficient of its spectrum, with two objects."""

BYTES_PER_THREAD = 110
"""Measured memory of a search in one block of frames, per coefficient."""

FALSE_ALARM = 1e-4
"""Probability that speckle looks like uneven lines of the sensor; the frequencies that are then left out are few."""

STEPS = 8
"""Steps between two frequencies in which the spectrum of a window is averaged."""


class Reader:
    """Reader of frames into spectra in one band.

    Once `band` has found hot pixels and uneven lines, all spectra are of frames without them. It leaves out the last rows and columns, a
    few in a hundred at most, where that makes its Fourier transforms several times faster.

    Args:
        shape: pixels of a frame. binning: pixels that are added along each axis.
    """

    def __init__(self, shape: tuple[int, int], binning: int) -> None:
        self.shape, self._binning = (prev_fast_len(shape[0] // binning), prev_fast_len(shape[1] // binning)), binning
        self._levelled: tuple[int, ...] = ()
        self._hot: HotPixels | None = None

    def whole(self, frame: np.ndarray, taper: float = TAPER) -> np.ndarray:
        """Return the spectrum (rows, columns // 2 + 1) of a frame less its mean and, where lines are uneven, theirs, complex64."""
        image = self._image(frame)
        image = image - image.mean(dtype=np.float64).astype(np.float32)  # exactly zero for a blank frame
        for axis in self._levelled:
            image -= image.mean(axis, keepdims=True)
        rows, columns = (tukey(side, taper).astype(np.float32) for side in self.shape)
        return rfft2(image * rows[:, None] * columns)

    def _image(self, frame: np.ndarray) -> np.ndarray:
        """Return a frame after binning, without hot pixels, float32."""
        binned = self._bin(frame)
        return binned if self._hot is None else self._hot.replaced_in(binned)

    def _bin(self, frame: np.ndarray) -> np.ndarray:
        """Return means of blocks of pixels, float32. Sums of strided views take a fifth of the time of a library's pooling."""
        side = self._binning
        if side == 1:
            return np.ascontiguousarray(frame[: self.shape[0], : self.shape[1]], np.float32)
        rows, columns = (side * count for count in self.shape)
        lines = frame[:rows:side, :columns].astype(np.float32)
        for step in range(1, side):
            lines += frame[step:rows:side, :columns]
        binned = lines[:, ::side].copy()
        for step in range(1, side):
            binned += lines[:, step::side]
        return binned / side**2

    def band(self, frames: Sequence[np.ndarray]) -> Band | None:
        """Return the band of the speckle, from the first frames; None if they show none."""
        first, taper = frames[:FRAMES_FOR_POWER], TAPER
        self._hot = HotPixels.of(map(self._bin, first))
        band = self._band(first, taper)
        if band is None or band.is_dim:
            more = frames[:DIM_FRAMES_FOR_POWER]
            if len(more) > len(first):
                self._hot = HotPixels.of(map(self._bin, more))
                if (found := self._band(more, taper)) is not None:
                    first, band = more, found
        while band is not None and band.needs_wider_taper:
            taper = 2.0 * taper
            band = self._band(first, taper)
        return band and replace(band, contrast=self._contrast(band, first[:FRAMES_FOR_POWER]))

    def _band(self, first: Sequence[np.ndarray], taper: float) -> Band | None:
        """Return the band of frames through a window. Uneven lines of these frames are levelled from then on."""
        power = self._power(first, taper)
        if uneven := tuple(axis for axis in (0, 1) if axis not in self._levelled and lines_are_uneven(power, axis)):
            self._levelled += uneven
            power = self._power(first, taper)
        rows, columns = np.fft.fftfreq(self.shape[0]), np.fft.rfftfreq(self.shape[1])
        radius = np.hypot(rows[:, None], columns[None]) / 0.5
        periods = np.abs(rows[:, None]) * self.shape[0], columns[None] * self.shape[1]
        is_slow = np.hypot(*periods) <= SLOW_PERIODS
        for axis in self._levelled:
            is_slow |= periods[axis] <= SLOW_PERIODS
            _fill_slow(power, axis)
        for side in SMOOTHING:
            smooth = uniform_filter(_full_plane(power, self.shape[1]), side, mode="wrap")[:, : power.shape[1]]
            floor = float(np.median(smooth[(radius > OUTER) & (radius <= 1.0)]))
            leaked = _leakage(smooth - floor, self.shape, taper)
            signal = smooth - floor - leaked
            is_signal = signal > SIGNAL_SIGMA * floor / (len(first) * side**2) ** 0.5  # of exponential variables
            # Noise exceeds the limit here and there at high frequencies, which would make the maximum falsely sharp.
            regions, _ = label(np.roll(is_signal, len(rows) // 2, 0))
            if middle := regions[len(rows) // 2, 0]:
                inside = np.roll(regions == middle, -(len(rows) // 2), 0) & ~is_slow
                if inside.any(1).sum() > 1 and inside.any(0).sum() > 1:
                    return replace(self._crop(signal, inside, floor, leaked), taper=taper)
        return None

    def _power(self, frames: Sequence[np.ndarray], taper: float) -> np.ndarray:
        """Return the mean power spectrum (rows, columns // 2 + 1) of frames."""
        power, light = np.zeros((self.shape[0], self.shape[1] // 2 + 1)), np.zeros((0, 1))
        for start in range(0, len(frames), FRAMES_FOR_POWER):
            some = frames[start : start + FRAMES_FOR_POWER]
            powers = np.array(on_all_cores(lambda frame: np.abs(self.whole(frame, taper)) ** 2, some))
            light = np.concatenate([light, powers.sum((1, 2), np.float64)[:, None]])
            power += np.tensordot(brightness_limits(light)[start:] ** 2, powers, 1)
        return power / len(frames)

    def _contrast(self, band: Band, frames: Sequence[np.ndarray]) -> float:
        """Return the standard deviation of the speckle in a band over the mean light, at most 1."""
        window = np.prod([(tukey(side, band.taper) ** 2).sum() for side in self.shape])
        variance = band.power / (np.prod(self.shape) * window)
        light = float(np.mean([self._image(frame).mean(dtype=np.float64) for frame in frames]))
        return min(1.0, variance**0.5 / max(light, 1e-300))

    def _crop(self, signal: np.ndarray, inside: np.ndarray, noise: float, leaked: np.ndarray) -> Band:
        rows, columns = np.fft.fftfreq(self.shape[0]), np.fft.rfftfreq(self.shape[1])
        highest = int(np.abs(np.round(rows[inside.any(1)] * self.shape[0])).max())
        kept = np.arange(-highest, min(highest, self.shape[0] - highest - 1) + 1)
        across = int(np.flatnonzero(inside.any(0)).max()) + 1
        is_double = (np.arange(across) > 0) & (np.arange(across) < (self.shape[1] + 1) // 2)
        counts = inside[kept][:, :across] * np.where(is_double, 2.0, 1.0)
        return Band(
            self.shape,
            rows[kept],
            columns[:across],
            counts,
            np.where(inside, signal, 0.0)[kept][:, :across],
            noise,
            noise + leaked[kept][:, :across],
        )

    def spectra(self, frame: np.ndarray, band: Band) -> np.ndarray:
        """Return the spectrum of a frame in a band, complex64 (R, C)."""
        kept = np.round(band.rows * self.shape[0]).astype(int)
        return self.whole(frame, band.taper)[kept][:, : len(band.columns)]

    def all_spectra(self, frames: Sequence[np.ndarray], band: Band, advance: Callable[[], object] = lambda: None) -> np.ndarray:
        """Return the spectra of frames in a band, (n, R, C); `advance` is called after each."""

        def read(number: int) -> np.ndarray:
            found = self.spectra(frames[number], band)
            advance()
            return found

        found = np.stack(on_all_cores(read, range(len(frames))))
        limits = brightness_limits(np.array([np.vdot(one, one).real for one in found]))
        return found if limits.min() == 1.0 else found * limits[:, None, None]


def frames_in_memory(band: Band) -> int:
    """Return the largest number of frames that are tracked in the memory of this machine."""
    left = memory_bytes() - torch.get_num_threads() * band.signal.size * BYTES_PER_THREAD
    return max(0, int(left / (band.signal.size * BYTES_PER_COEFFICIENT)))


def lines_are_uneven(power: np.ndarray, axis: int) -> bool:
    """Return whether a power spectrum (H, W // 2 + 1) has more power at the frequency zero of an axis than speckle has.

    What the rows (axis 1) or columns (axis 0) of a sensor add to all their pixels is there. The powers of speckle are exponential
    variables, about a mean that falls from zero frequency no faster than a geometric sequence does.
    """
    lines = power if axis == 0 else power.T
    near, far = (
        uniform_filter1d(lines[first : first + 3].mean(0), SMOOTHING[0]) for first in (SLOW_PERIODS + 1, SLOW_PERIODS + 5)
    )
    expected = near * np.maximum(near / np.maximum(far, 1e-300), 1.0)
    kept = slice(SLOW_PERIODS + 1, lines.shape[1] // 2 if axis == 1 else None)
    ratios = lines[0, kept] / np.maximum(expected[kept], 1e-300)
    return float(ratios.mean()) > gamma.isf(FALSE_ALARM, len(ratios)) / len(ratios)


def _fill_slow(power: np.ndarray, axis: int) -> None:
    """Give the slow frequencies of an axis of a power spectrum (H, W // 2 + 1) the power of those beyond them, because smoothing would mix
    these with zeros."""
    lines = np.moveaxis(power, axis, 0)
    slow = np.arange(-SLOW_PERIODS if axis == 0 else 0, SLOW_PERIODS + 1)
    lines[slow] = lines[np.where(slow < 0, -1, 1) * (2 * SLOW_PERIODS + 1 - np.abs(slow))]


def _full_plane(power: np.ndarray, columns: int) -> np.ndarray:
    """Return a power spectrum (H, columns) whose columns of zero or more are given, (H, columns // 2 + 1)."""
    opposite = np.roll(power[::-1], 1, 0)[:, 1 : columns - power.shape[1] + 1]
    return np.concatenate([power, opposite[:, ::-1]], 1)


def _leakage(power: np.ndarray, shape: tuple[int, int], taper: float) -> np.ndarray:
    """Return the part of a power spectrum (H, W // 2 + 1) that a window brings to each frequency from those more than `SLOW_PERIODS` away.

    It moves with the phases of those frequencies, so that it would draw displacements towards zero.
    """
    whole, near = [], []
    for side in shape:
        # The mean over a step of the frequencies: the spectrum of the speckle has power between them, too.
        fine = np.abs(fft(tukey(side, taper), STEPS * side)) ** 2
        spread = np.roll(fine, STEPS // 2).reshape(side, STEPS).mean(1)
        spread /= spread.sum()
        whole.append(fft(spread).real)
        near.append(fft(np.where(np.abs(fftfreq(side, 1.0 / side)) <= SLOW_PERIODS, spread, 0.0)).real)
    return np.maximum(rfft2(irfft2(power, s=shape) * (np.outer(*whole) - np.outer(*near))).real, 0.0)


def brightness_limits(powers: np.ndarray) -> np.ndarray:
    """Return factors (n,) for the spectra of frames with powers (n, ...) that limit each to `MAX_BRIGHTNESS` times the median light."""
    light = np.sqrt(powers.reshape(len(powers), -1).sum(1, dtype=np.float64))
    return np.minimum(1.0, MAX_BRIGHTNESS * np.median(light) / np.maximum(light, 1e-300)).astype(np.float32)
