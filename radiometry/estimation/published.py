"""The estimator of Metzler et al. 2020 (Eqs. 8 and 9): non-overlapping patches."""

from __future__ import annotations

import math

import numpy as np
import torch

from correlograph.errors import InputError
from radiometry.autocorrelation import PatchGrid
from radiometry.estimation.background import BackgroundRecord


def _spectra(patches: torch.Tensor, lags: int) -> torch.Tensor:
    """Return the half-plane spectra of patches at the lags: rows -lags..lags, columns 0..lags."""
    columns = torch.fft.rfft(patches, dim=-1)[..., : lags + 1]
    full = torch.fft.fft(columns, dim=-2)
    return torch.cat((full[..., -lags:, :], full[..., : lags + 1, :]), dim=-2)


class PublishedEstimator:
    """Running estimate over frames: add() each, then estimate().

    Eq. (8) averages |F I|^2, the power spectrum of a patch, over frames and patches. Eq. (9) subtracts the squared modulus
    of the mean spectrum: at each patch position if there are several frames, which also removes static patterns, and pooled
    over the patches for one frame. The estimate is unbiased.
    """

    def __init__(self, grid: PatchGrid, device: torch.device | str = "cpu") -> None:
        self.grid = grid
        self.frames = 0
        self.device = torch.device(device)
        self._power: torch.Tensor | None = None
        self._sum: torch.Tensor | None = None
        self._reference = 0.0
        self.background = BackgroundRecord("published")

    def add(self, frame: np.ndarray | torch.Tensor) -> None:
        """Add one frame, shape (H, W), any real dtype."""
        image = torch.as_tensor(frame, device=self.device).to(torch.float32)
        if self.frames == 0:
            self._reference = float(image.mean(dtype=torch.float64))
        # One constant for all frames leaves the estimate unchanged and keeps zero lag within float32.
        spectra = _spectra(self.grid.cut(image - self._reference), self.grid.lags)
        power = spectra.real.square().add_(spectra.imag.square())
        self._power = power if self._power is None else self._power.add_(power)
        self._sum = spectra if self._sum is None else self._sum.add_(spectra)
        self.frames += 1

    @property
    def dof(self) -> int:
        """Degrees of freedom K of the estimate for identically distributed frames and independent patches."""
        return published_dof(self.frames, self.grid.count)

    def estimate(self) -> np.ndarray:
        """Return the estimate, float32 (127, 127), zero lag in the middle: a power spectrum per pixel, in frame units squared."""
        if self._power is None or self._sum is None:
            raise InputError("frames", "at least one frame", 0, "give a folder or files that hold frames")
        if self.dof == 0:
            raise InputError(
                "patch",
                "at least two patches when there is a single frame",
                f"{self.grid.count} of {self.grid.size} pixels",
                "choose a smaller --patch or add a frame",
            )
        if self.frames > 1:
            total = self._power.sum(0) - self._sum.abs().square().sum(0) / self.frames
        else:
            total = self._power.sum(0) - self._sum.sum(0).abs().square() / self.grid.count
        half = (total / (self.dof * math.prod(self.grid.patch_shape))).cpu().numpy()
        lags, side = self.grid.lags, self.grid.lag_grid.side
        full = np.empty((side, side), np.float32)
        full[:, lags:] = half
        full[:, :lags] = half[::-1, :0:-1]
        full[:lags, lags] = half[:lags:-1, 0]
        return full


def published_dof(frames: int, patches: int) -> int:
    """Return K: patches x (frames - 1), because a mean is subtracted at each patch position; for one frame patches - 1,
    because one mean of all patches is subtracted.
    """
    return patches * (frames - 1) if frames > 1 else patches - 1
