"""Autocorrelation estimate from whole frames: all pixel pairs, and a background model chosen from the frames.

Metzler et al. 2020 average |F I|^2 over non-overlapping patches (Eq. 8) and subtract the squared mean field at each patch position
(Eq. 9); see `radiometry/estimation/published.py`. That discards pixel pairs across patch borders. It also spends half of the
information of two frames on a mean that is almost constant over the frame. This estimator differs in three ways:

- Patches overlap fully. The expectation is unchanged, because the autocovariance of all pixel pairs is weighted by a
  triangle, the autocorrelation of a boxcar patch (Blackman and Tukey, doi:10.1002/j.1538-7305.1958.tb03874.x; Welch,
  doi:10.1109/TAU.1967.1161901). K is `degrees_of_freedom`, and neighbouring lags are correlated
  (`radiometry.noise.model.lag_correlation`).
- Only background detected in the frames is subtracted: their mean, a smooth illumination (`illumination.py`), and a static pattern
  at those lags at which frames share power (`fixed_pattern.py`).
- Hot pixels, defective lines and periodic light are removed first (`pixel_faults.py`, `spectral_lines.py`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from threading import local
from typing import Any

import numpy as np
import torch
from scipy.fft import next_fast_len

from correlograph.errors import InputError
from correlograph.files.file_frames import frame_digest
from radiometry.autocorrelation import PatchGrid
from radiometry.estimation.background import BackgroundRecord, MeanModel
from radiometry.estimation.fixed_pattern import shared_lags, shift_between
from radiometry.estimation.frame_sums import FrameSums
from radiometry.estimation.illumination import flatten_illumination, is_uneven
from radiometry.estimation.photon_transfer import combine, photon_transfer
from radiometry.estimation.pixel_faults import repair
from radiometry.estimation.published import PublishedEstimator
from radiometry.estimation.spectral_lines import MIN_PATCHES, find_lines, lower_lines, subtract_waves
from radiometry.estimation.third_moment import MAX_FRAMES, FilteredFrames, narrow

MIN_COPY_CORRELATION = 1.0 - 1e-6
"""Minimum correlation of frames that are copies of one frame."""

MAX_GAIN = 5.0
"""Largest factor by which a dim frame is brightened for the third moment; dimmer ones are left out."""


def degrees_of_freedom(frames: int, frame_shape: tuple[int, int], patch_shape: tuple[int, int]) -> float:
    """Return K of a lag of white noise: frames times, along both axes, L / sum over d of w(d)^2 / (1 - d / L).

    w is the triangle of a patch, L the side of the frame, d the lag in pixels. If many patches fit, K is 9 / 4 of their number; for
    one patch of the size of the frame it is 1.
    """
    per_frame = 1.0
    for length, size in zip(frame_shape, patch_shape, strict=True):
        apart = np.abs(np.arange(1 - size, size))
        per_frame *= length / float(((1.0 - apart / size) ** 2 / (1.0 - apart / length)).sum())
    return frames * per_frame


class AutocorrelationEstimator:
    """Running estimate over frames: add() each, then estimate().

    Args:
        grid: patches whose lags the estimate has; their number is irrelevant.
        mean: `auto` detects the background; `pooled` subtracts the mean of each frame only; `fixed` subtracts the power
            common to all frames at every lag, as Eq. (9) does, which halves K for two frames.
    """

    def __init__(self, grid: PatchGrid, device: torch.device | str = "cpu", mean: MeanModel = "auto") -> None:
        self.grid, self.device, self.mean = grid, torch.device(device), mean
        self.background = BackgroundRecord(mean)
        """Background and sensor faults; complete after estimate()."""
        self._patch = grid.patch_shape
        self.padded = (
            next_fast_len(grid.frame_shape[0] + self._patch[0] - 1),
            next_fast_len(grid.frame_shape[1] + self._patch[1] - 1),
        )
        self.sums = FrameSums()
        """Sums over the frames that were added."""
        self._memory = local()
        self._first = torch.empty(0)
        self._first_lags = np.empty(0)
        self._uneven = self._is_pattern_shared = False

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_memory"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _memory=local())

    def add(self, frame: np.ndarray | torch.Tensor) -> None:
        """Add one frame, shape (H, W), any real dtype."""
        if self.frames == 0:
            self.start(frame)
        else:
            self.sums.add(self.sums_of(frame, self.frames))

    def start(self, frame: np.ndarray | torch.Tensor) -> None:
        """Add the first frame, with which the others are compared."""
        self._first = torch.empty(0)
        self.sums = FrameSums()
        self.sums.add(self.sums_of(frame, 0))
        self._first = self.sums.spectrum.clone()
        self._first_lags = self.at_lags(self.sums.power)
        self._is_pattern_shared = False

    def sums_of(self, frame: np.ndarray | torch.Tensor, number: int) -> FrameSums:
        """Return the sums of one frame; `number` counts the frames of the capture from 0.

        Several threads may call this method for frames after the first one. The tensors last until the next call in the same thread.
        """
        image = torch.as_tensor(frame, device=self.device).to(torch.float32)
        sums = FrameSums(digests=[frame_digest(image.cpu().numpy())])
        if self.mean == "auto":
            image, sums.faults = repair(image)
        if number < MAX_FRAMES:
            sums.noise.append(photon_transfer(image))
        if self.mean == "auto":
            if number == 0:  # All frames are treated alike; otherwise their shared part would not cancel.
                self._uneven = is_uneven(image, self._patch)
            if self._uneven:
                image = flatten_illumination(image, self._patch)
        sums.levels.append(float(image.mean(1).mean(dtype=torch.float64)))  # all in double precision takes as long as the FFT
        spectrum, power = self.spectrum_of(image, sums.levels[0])
        if self.mean == "auto" and self.grid.count >= MIN_PATCHES:
            per_lag = self.padded[0] / self._patch[0], self.padded[1] / self._patch[1]
            if lines := find_lines(power, per_lag, self.grid.lags):
                spectrum, power = self.spectrum_of(subtract_waves(image - sums.levels[0], lines, self.padded))
                lower_lines(spectrum, power, lines)
                sums.spectral_lines = len(lines)
        if number < MAX_FRAMES:
            sums.narrow.append(narrow(spectrum, self.padded, self._patch, self.grid.lags))
        if number > 0 and self.mean == "auto":
            spectrum, sums.shift_pixels = self._moved_back(spectrum, number)
        sums.spectrum, sums.power = spectrum, power
        return sums

    @property
    def frames(self) -> int:
        """Number of frames that were added."""
        return self.sums.frames

    def spectrum_of(self, image: torch.Tensor, level: float = 0.0) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the spectrum (rows, columns // 2 + 1) of a padded frame minus a level, and its power."""
        padded, spectrum, power = self._buffers()
        torch.sub(image, level, out=padded[: image.shape[0], : image.shape[1]])
        torch.fft.rfft2(padded, out=spectrum)
        torch.mul(spectrum.real, spectrum.real, out=power).addcmul_(spectrum.imag, spectrum.imag)
        return spectrum, power

    def _buffers(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return a padded frame, a spectrum and its power for the calling thread. New memory for each frame would cost more than sums."""
        if not hasattr(self._memory, "buffers"):
            half = (self.padded[0], self.padded[1] // 2 + 1)
            self._memory.buffers = (
                torch.zeros(self.padded, device=self.device),
                torch.empty(half, dtype=torch.complex64, device=self.device),
                torch.empty(half, device=self.device),
            )
        return self._memory.buffers

    def filtered_frames(self) -> FilteredFrames:
        """Return the band-limited frames for the third moment, all with the light to which r*r is proportional: the rms of all frames."""
        levels = np.array(self.sums.levels)
        usual = float(np.sqrt(np.square(levels).mean()))
        shown = [(usual / level, one) for level, one in zip(levels, self.sums.narrow, strict=False) if level > 0.0]
        bright = [(gain, one) for gain, one in shown if gain < MAX_GAIN] or shown or [(1.0, one) for one in self.sums.narrow]
        gains, mean = np.array([gain for gain, _ in bright]), float(levels.mean())
        return FilteredFrames(
            tuple(gain * one for gain, one in bright),
            self.padded,
            self.grid.frame_shape,
            self._patch,
            mean,
            combine(self.sums.noise),
            self.grid.lags,
            gain=float(gains.mean()),
            noise_gain=float(np.square(gains).mean() * usual / mean) if mean > 0.0 else 1.0,
        )

    @property
    def dof(self) -> float:
        """Degrees of freedom K of a lag without static pattern."""
        counted = self.frames if self.mean != "fixed" or self.frames == 1 else self.frames - 1
        return degrees_of_freedom(counted, self.grid.frame_shape, self._patch)

    def estimate(self) -> np.ndarray:
        """Return the estimate, float32 (127, 127), zero lag in the middle: the power spectrum of the frames
        divided by the number of pixels, in frame units squared.

        Raises InputError without frames, for a single frame with a single patch, and for copies of one frame.
        """
        if self.frames == 0:
            raise InputError("frames", "at least one frame", 0, "give a folder or files that hold frames")
        if self.frames == 1 and self.grid.count == 1:
            raise InputError(
                "patch",
                "at least two patches when there is a single frame",
                f"{self.grid.count} of {self.grid.size} pixels",
                "choose a smaller --patch or add a frame",
            )
        estimate = self.at_lags(self.sums.power / self.frames)
        if self.frames > 1:
            shared_power = self._shared_power()
            self._check_copies(shared_power)
            shared = self.at_lags(shared_power)
            chosen = self._chosen(shared, estimate)
            estimate = np.where(chosen, estimate - self._drift() * shared, estimate)
            self._record(fixed_pattern_lags=float(chosen.mean()))
        faults = self.sums.faults
        self._record(
            uneven_illumination=self._uneven,
            spectral_lines=self.sums.spectral_lines,
            shift_pixels=self.sums.shift_pixels,
        )
        if self.mean == "auto":
            self._record(hot_pixels=faults.hot_pixels, faulty_lines=faults.lines, saturated=faults.saturated)
        return estimate.astype(np.float32)

    def _record(self, **found: Any) -> None:
        self.background = replace(self.background, **found)

    def _shared_power(self) -> torch.Tensor:
        """Return the real part of the cross-spectrum, averaged over pairs of frames."""
        total = self.sums.spectrum.real.square().add_(self.sums.spectrum.imag.square())
        return total.sub_(self.sums.power).div_(self.frames * (self.frames - 1))

    def _chosen(self, shared: np.ndarray, estimate: np.ndarray) -> np.ndarray:
        """Return a mask (127, 127) of the lags at which the power that all frames share is subtracted."""
        if self.mean != "auto":
            return np.full(shared.shape, self.mean == "fixed")
        pairs = self.frames * (self.frames - 1)
        return shared_lags(shared, estimate, pairs * degrees_of_freedom(1, self.grid.frame_shape, self._patch))

    def _drift(self) -> float:
        """Return the mean square of the frames' means divided by the mean product of the means of two frames. Drift of a
        lamp raises the power of its pattern by this factor above the power that frames share.
        """
        levels = np.array(self.sums.levels)
        pairs = (levels.sum() ** 2 - (levels**2).sum()) / (self.frames - 1)
        return float((levels**2).sum() / pairs) if levels.min() > 0.0 else 1.0

    def _moved_back(self, spectrum: torch.Tensor, number: int) -> tuple[torch.Tensor, tuple[float, float] | None]:
        """Return the spectrum of a frame, corrected for camera shift, and the shift; None without a static pattern.

        If none of the first `MAX_FRAMES` frames has a pattern in common with the first one, later frames are not searched for it.
        """
        if number >= MAX_FRAMES and not self._is_pattern_shared:
            return spectrum, None
        cross = self._first.real * spectrum.real + self._first.imag * spectrum.imag
        dof = 2.0 * degrees_of_freedom(1, self.grid.frame_shape, self._patch)
        if not shared_lags(self.at_lags(cross), self._first_lags, dof).any():
            return spectrum, None
        shift = shift_between(self._first, spectrum, self.padded, number)
        self._is_pattern_shared |= shift != (0.0, 0.0)
        return self.move_back(spectrum, shift), shift

    def move_back(self, spectrum: torch.Tensor, shift: Sequence[float]) -> torch.Tensor:
        """Return the spectrum of a padded frame moved back by a shift in pixels along rows and columns."""
        rows, columns = torch.fft.fftfreq(self.padded[0]), torch.fft.rfftfreq(self.padded[1])
        turn = 2.0 * math.pi * (rows[:, None] * shift[0] + columns[None] * shift[1]).to(self.device)
        return spectrum * torch.polar(torch.ones_like(turn), turn)

    def _check_copies(self, shared_power: torch.Tensor) -> None:
        power = float(self.sums.power.sum()) / self.frames
        correlation = float(shared_power.sum()) / power if power > 0.0 else 0.0
        self._record(frames_correlate=correlation)
        if correlation > MIN_COPY_CORRELATION:
            raise InputError("frames", "frames of different illuminations", "copies of one frame", "leave the copies out")

    def at_lags(self, power: torch.Tensor) -> np.ndarray:
        """Return the power spectrum of padded frames (rows, columns // 2 + 1) at the lags (127, 127), smoothed by the patch
        window.
        """
        (height, width), (rows, columns) = self.grid.frame_shape, self.padded
        down = spectral_window(height, self._patch[0], rows, self.grid.lags)
        right = spectral_window(width, self._patch[1], columns, self.grid.lags)[:, : columns // 2 + 1].copy()
        right[:, 0] *= 0.5  # column zero holds both halves of the plane
        if columns % 2 == 0:
            right[:, -1] *= 0.5
        down, right = (torch.from_numpy(window.astype(np.float32)).to(self.device) for window in (down, right))
        half = (down @ power @ right.T).cpu().numpy().astype(np.float64) / (height * width)
        return half + half[::-1, ::-1]


@lru_cache(maxsize=8)
def spectral_window(length: int, size: int, padded: int, lags: int) -> np.ndarray:
    """Return weights (2 lags + 1, padded) that convert the power along a padded axis to lags: the Fourier transform of the
    patch triangle divided by the fraction of pixels that have a partner at each distance.
    """
    apart = np.arange(1 - size, size)
    triangle = (1.0 - np.abs(apart) / size) / (1.0 - np.abs(apart) / length)
    on_circle = np.zeros((2 * lags + 1, padded), np.complex128)
    on_circle[:, apart % padded] = triangle * np.exp(-2j * np.pi * np.arange(-lags, lags + 1)[:, None] * apart / size)
    return np.fft.ifft(on_circle).real


def estimate_autocorrelation(
    frames: Iterable[np.ndarray | torch.Tensor], grid: PatchGrid, mean: MeanModel = "auto", device: torch.device | str = "cpu"
) -> tuple[np.ndarray, float]:
    """Estimate the autocorrelation of frames; return (estimate (127, 127), degrees of freedom)."""
    estimator = estimator_of(grid, mean, device)
    for frame in frames:
        estimator.add(frame)
    return estimator.estimate(), estimator.dof


def estimator_of(
    grid: PatchGrid, mean: MeanModel = "auto", device: torch.device | str = "cpu"
) -> AutocorrelationEstimator | PublishedEstimator:
    """Return the estimator of a background model; add frames to it."""
    return PublishedEstimator(grid, device) if mean == "published" else AutocorrelationEstimator(grid, device, mean)
