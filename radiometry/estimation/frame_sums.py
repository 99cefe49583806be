"""Sums over frames from which an estimate follows. Sums of parts of a capture add up to the sums of the capture."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch

from radiometry.estimation.photon_transfer import PhotonTransfer
from radiometry.estimation.pixel_faults import PixelFaults


@dataclass
class FrameSums:
    """Sums over some frames of a capture, in the order of the frames.

    Attributes:
        levels: mean of each frame.
        digests: digest of each frame, by which saved sums are recognised (`correlograph.files.file_frames.frame_digest`).
        spectrum: sum of the spectra of the padded frames without their means, complex64 (rows, columns // 2 + 1); empty without frames.
        power: sum of their squared moduli, float32 of the same shape.
        narrow: spectra of the first frames of the capture, cropped to the lags (`third_moment.narrow`).
        noise: noise of the pixels of these frames.
        faults: sensor faults: the number of hot pixels in all frames, and the largest numbers of other faults in a frame.
        spectral_lines: number of waves that were subtracted.
        shift_pixels: largest shift of the camera, rows and columns; None if frames share no pattern.
    """

    levels: list[float] = field(default_factory=list)
    digests: list[bytes] = field(default_factory=list)
    spectrum: torch.Tensor = field(default_factory=lambda: torch.empty(0, dtype=torch.complex64))
    power: torch.Tensor = field(default_factory=lambda: torch.empty(0))
    narrow: list[torch.Tensor] = field(default_factory=list)
    noise: list[PhotonTransfer] = field(default_factory=list)
    faults: PixelFaults = field(default_factory=PixelFaults)
    spectral_lines: int = 0
    shift_pixels: tuple[float, float] | None = None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.levels)

    def add(self, following: FrameSums) -> None:
        """Add the sums of the frames that follow, whose tensors are not kept."""
        if not self.levels:
            self.spectrum, self.power = following.spectrum.clone(), following.power.clone()
        elif following.levels:
            self.spectrum.add_(following.spectrum)
            self.power.add_(following.power)
        self.levels += following.levels
        self.digests += following.digests
        self.narrow += following.narrow
        self.noise += following.noise
        self.faults = PixelFaults(
            self.faults.hot_pixels + following.faults.hot_pixels,
            max(self.faults.lines, following.faults.lines),
            max(self.faults.saturated, following.faults.saturated),
        )
        self.spectral_lines += following.spectral_lines
        shifts = [shift for shift in (self.shift_pixels, following.shift_pixels) if shift is not None]
        self.shift_pixels = max(shifts, key=lambda shift: float(np.hypot(*shift)), default=None)
