"""Autocorrelation estimate from whole frames: all pixel pairs, and a background model chosen from the frames.

Metzler et al. 2020 average |F I|^2 over non-overlapping patches (Eq. 8) and subtract the squared mean field at each patch position
(Eq. 9); see `radiometry/estimation/published.py`. That discards pixel pairs across patch borders. It also spends half of the
information of two frames on a mean that is almost constant over the frame. This estimator differs in three ways:

- Patches overlap fully. The expectation is unchanged, because the autocovariance of all pixel pairs is weighted by the triangle of
  a boxcar patch (Blackman and Tukey, doi:10.1002/j.1538-7305.1958.tb03874.x; Welch, doi:10.1109/TAU.1967.1161901). K is
  `degrees_of_freedom`, and neighbouring lags are correlated (`radiometry.noise.model.lag_correlation`).
- Only background detected in the frames is subtracted: their mean, a smooth illumination (`illumination.py`), and a static pattern
  at those lags at which frames share power (`fixed_pattern.py`).
- Hot pixels, defective lines and periodic light are removed first (`pixel_faults.py`, `spectral_lines.py`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from scipy.fft import next_fast_len

from correlograph.errors import InputError
from radiometry.autocorrelation import PatchGrid
from radiometry.estimation.background import BackgroundRecord, MeanModel
from radiometry.estimation.fixed_pattern import shared_lags, shift_between
from radiometry.estimation.illumination import flatten_illumination, is_uneven
from radiometry.estimation.photon_transfer import PhotonTransfer, combine, photon_transfer
from radiometry.estimation.pixel_faults import PixelFaults, repair
from radiometry.estimation.published import PublishedEstimator
from radiometry.estimation.spectral_lines import MIN_PATCHES, find_lines, lower_lines, subtract_waves
from radiometry.estimation.third_moment import MAX_FRAMES, FilteredFrames, narrow

MIN_COPY_CORRELATION = 1.0 - 1e-6
"""Minimum correlation of frames that are copies of one frame."""


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
        mean: `auto` detects the background; `pooled` subtracts the mean of each frame only; `fixed` subtracts what the frames share
            at every lag, as Eq. (9) does, which halves K for two frames.
    """

    def __init__(self, grid: PatchGrid, device: torch.device | str = "cpu", mean: MeanModel = "auto") -> None:
        self.grid, self.device, self.mean = grid, torch.device(device), mean
        self.frames = 0
        self.background = BackgroundRecord(mean)
        """Background and sensor faults; complete after estimate()."""
        self._patch = grid.patch_shape
        self.padded = (
            next_fast_len(grid.frame_shape[0] + self._patch[0] - 1),
            next_fast_len(grid.frame_shape[1] + self._patch[1] - 1, real=True),
        )
        self._first = self._sum = self._power = torch.empty(0)
        self._first_lags: np.ndarray | None = None
        self._levels: list[float] = []
        self._uneven: bool | None = None
        self._narrow: list[torch.Tensor] = []
        self._faults: list[PixelFaults] = []
        self._lines = 0
        self._noise: list[PhotonTransfer] = []

    def add(self, frame: np.ndarray | torch.Tensor) -> None:
        """Add one frame, shape (H, W), any real dtype."""
        image = torch.as_tensor(frame, device=self.device).to(torch.float32)
        if self.mean == "auto":
            image, faults = repair(image)
            self._faults.append(faults)
        if len(self._noise) < MAX_FRAMES:
            self._noise.append(photon_transfer(image))
        if self.mean == "auto":
            if self._uneven is None:  # All frames are treated alike; otherwise their shared part would not cancel.
                self._uneven = is_uneven(image, self._patch)
            if self._uneven:
                image = flatten_illumination(image, self._patch)
        level = float(image.mean(dtype=torch.float64))
        image = image - level
        self._levels.append(level)
        spectrum, power = self._spectrum(image)
        if self.mean == "auto" and self.grid.count >= MIN_PATCHES:
            per_lag = self.padded[0] / self._patch[0], self.padded[1] / self._patch[1]
            if lines := find_lines(power, per_lag, self.grid.lags):
                spectrum, power = self._spectrum(subtract_waves(image, lines, self.padded))
                lower_lines(spectrum, power, lines)
                self._lines += len(lines)
        if len(self._narrow) < MAX_FRAMES:
            self._narrow.append(narrow(spectrum, self.padded, self._patch, self.grid.lags))
        if self.frames == 0:
            self._first = self._sum = spectrum
            self._power = power
        else:
            self._sum = self._sum + self._moved_back(spectrum)
            self._power.add_(power)
        self.frames += 1

    def _spectrum(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the spectrum (rows, columns // 2 + 1) of a padded frame, and its power."""
        spectrum = torch.fft.rfft2(image, s=self.padded)
        return spectrum, spectrum.real.square().add_(spectrum.imag.square())

    def filtered_frames(self) -> FilteredFrames:
        """Return the band-limited frames for the third moment."""
        level = float(np.mean(self._levels))
        noise = combine(self._noise)
        return FilteredFrames(
            tuple(self._narrow), self.padded, self.grid.frame_shape, self._patch, level, noise, self.grid.lags
        )

    @property
    def dof(self) -> float:
        """Degrees of freedom K of a lag without static pattern."""
        counted = self.frames if self.mean != "fixed" or self.frames == 1 else self.frames - 1
        return degrees_of_freedom(counted, self.grid.frame_shape, self._patch)

    def estimate(self) -> np.ndarray:
        """Return the estimate, float32 (127, 127), zero lag in the middle: a power spectrum per pixel, in frame units squared.

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
        estimate = self._at_lags(self._power / self.frames)
        if self.frames > 1:
            shared_power = self._shared_power()
            self._check_copies(shared_power)
            shared = self._at_lags(shared_power)
            chosen = self._chosen(shared, estimate)
            estimate = np.where(chosen, estimate - self._drift() * shared, estimate)
            self._record(fixed_pattern_lags=float(chosen.mean()))
        self._record(uneven_illumination=bool(self._uneven), spectral_lines=self._lines)
        if self._faults:
            self._record(
                hot_pixels=sum(one.hot_pixels for one in self._faults),
                faulty_lines=max(one.lines for one in self._faults),
                saturated=max(one.saturated for one in self._faults),
            )
        return estimate.astype(np.float32)

    def _record(self, **found: Any) -> None:
        self.background = replace(self.background, **found)

    def _shared_power(self) -> torch.Tensor:
        """Return the real part of the cross-spectrum, averaged over pairs of frames."""
        total = self._sum.real.square().add_(self._sum.imag.square())
        return total.sub_(self._power).div_(self.frames * (self.frames - 1))

    def _chosen(self, shared: np.ndarray, estimate: np.ndarray) -> np.ndarray:
        """Return a mask (127, 127) of the lags at which the power that all frames share is subtracted."""
        if self.mean != "auto":
            return np.full(shared.shape, self.mean == "fixed")
        pairs = self.frames * (self.frames - 1)
        return shared_lags(shared, estimate, pairs * degrees_of_freedom(1, self.grid.frame_shape, self._patch))

    def _drift(self) -> float:
        """Return the mean square of the frame levels over the mean product of the levels of two frames; drift of a lamp scales
        the power of its pattern by this factor."""
        levels = np.array(self._levels)
        pairs = (levels.sum() ** 2 - (levels**2).sum()) / (self.frames - 1)
        return float((levels**2).sum() / pairs) if levels.min() > 0.0 else 1.0

    def _moved_back(self, spectrum: torch.Tensor) -> torch.Tensor:
        """Return the spectrum of a frame, corrected for camera shift if a static pattern shows one."""
        if self.mean != "auto":
            return spectrum
        cross = self._first.real * spectrum.real + self._first.imag * spectrum.imag
        if self._first_lags is None:
            self._first_lags = self._at_lags(self._power)  # so far, of the first frame alone
        dof = 2.0 * degrees_of_freedom(1, self.grid.frame_shape, self._patch)
        if not shared_lags(self._at_lags(cross), self._first_lags, dof).any():
            return spectrum
        shift = shift_between(self._first, spectrum, self.padded, self.frames)
        largest = max(shift, self.background.shift_pixels or (0.0, 0.0), key=lambda pixels: math.hypot(*pixels))
        self._record(shift_pixels=largest)
        rows, columns = torch.fft.fftfreq(self.padded[0]), torch.fft.rfftfreq(self.padded[1])
        turn = 2.0 * math.pi * (rows[:, None] * shift[0] + columns[None] * shift[1]).to(self.device)
        return spectrum * torch.polar(torch.ones_like(turn), turn)

    def _check_copies(self, shared_power: torch.Tensor) -> None:
        power = float(self._power.sum()) / self.frames
        correlation = float(shared_power.sum()) / power if power > 0.0 else 0.0
        self._record(frames_correlate=correlation)
        if correlation > MIN_COPY_CORRELATION:
            raise InputError("frames", "frames of different illuminations", "copies of one frame", "leave the copies out")

    def _at_lags(self, power: torch.Tensor) -> np.ndarray:
        """Return the lags (127, 127) of the power spectrum of padded frames (rows, columns // 2 + 1), weighted by the
        patch window."""
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
    """Return weights (2 lags + 1, padded) that convert the power along a padded axis to lags: the transform of the patch
    triangle over the fraction of the frame that has pairs at each distance."""
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
