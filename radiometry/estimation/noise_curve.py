"""Noise of a camera's pixels over their light, from one frame: variance = offset + gain I + roughness I^2.

The first term is read noise less the camera's offset times the gain, the second one shot noise, the third one the subjective speckle
of a rough wall, whose relative variance per pixel is the roughness. As in `photon_transfer.py`, the squared diagonal difference of a
block of 2 x 2 pixels is compared with the pixels around it; their noise is independent, so that products of them and of the block
are unbiased (instrumental variables; Wooldridge, Econometric Analysis of Cross Section and Panel Data, section 5.2).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

STRIP_ROWS = 64
"""Rows of a frame that are processed at once, so that they stay in the cache."""


@dataclass(frozen=True)
class NoiseCurve:
    """Coefficients (offset, gain, roughness) in frame units, and their covariance (3, 3)."""

    coefficients: np.ndarray
    covariance: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """Standard errors of the coefficients."""
        return np.sqrt(np.diagonal(self.covariance).clip(0.0))

    def given(self, number: int, value: float) -> NoiseCurve:
        """Return the curve with the likeliest other coefficients if coefficient `number` has a known value."""
        pull = self.covariance[:, number] / max(self.covariance[number, number], 1e-300)
        coefficients = self.coefficients + pull * (value - self.coefficients[number])
        return NoiseCurve(coefficients, self.covariance - np.outer(pull, self.covariance[number]))


def noise_curve(frames: Sequence[torch.Tensor], used: Sequence[torch.Tensor]) -> NoiseCurve:
    """Fit the curve to frames (H, W) of one camera setting, whose grains are wider than two pixels.

    Args:
        used: measured pixels (H, W) of each frame, bool; blocks that touch others are left out.
    """
    level = float(np.mean([float(frame[mask].mean()) for frame, mask in zip(frames, used, strict=True)]))
    unit = max(float(np.mean([float(frame[mask].std()) for frame, mask in zip(frames, used, strict=True)])), 1e-30)

    def strips() -> Iterator[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]:
        for frame, mask in zip(frames, used, strict=True):
            height, width = (2 * (side // 2) for side in frame.shape)
            for top in range(0, height - 4, STRIP_ROWS):
                rows = slice(top, min(top + STRIP_ROWS + 4, height))
                instruments, regressors, target = _terms((frame[rows, :width] - level) / unit)
                missing = torch.nn.functional.max_pool2d((~mask[rows, 1:width]).float()[None, 1:], 4, 2)[0]
                yield instruments * (missing == 0.0).flatten(), regressors, target

    moments, targets, scatter = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
    for instruments, regressors, target in strips():
        moments += (instruments @ regressors.T).double().numpy()
        targets += (instruments @ target).double().numpy()
    inverse = np.linalg.pinv(moments)
    solved = inverse @ targets
    for instruments, regressors, target in strips():
        left = instruments * (target - torch.from_numpy(solved).to(target) @ regressors)
        scatter += (left @ left.T).double().numpy()
    covariance = inverse @ scatter @ inverse.T
    # Undo the scaling to zero mean and unit deviation: I = level + unit i.
    change = np.array(
        [
            [unit**2, -unit * level, level**2],
            [0.0, unit, -2.0 * level],
            [0.0, 0.0, 1.0],
        ]
    )
    return NoiseCurve(change @ solved, change @ covariance @ change.T)


def _terms(pixels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return instruments (3, n), regressors (3, n) and squared diagonal differences (n,) of the blocks of a strip."""
    upper, lower = pixels[2:-2:2], pixels[3:-2:2]
    down, across = upper + lower, upper - lower
    block = (0.25 * (down[:, 2:-2:2] + down[:, 3:-2:2])).flatten()
    square = (0.5 * (across[:, 2:-2:2] - across[:, 3:-2:2])).square().flatten()
    beside = (0.25 * (down[:, 1:-4:2] + down[:, 4::2])).flatten()
    rows = pixels[1:-4:2] + pixels[4::2]
    above = (0.125 * (rows[:, 1:-4:2] + rows[:, 2:-3:2] + rows[:, 3:-2:2] + rows[:, 4::2])).flatten()
    ones = torch.ones_like(block)
    return torch.stack((ones, above, above.square())), torch.stack((ones, block, block * beside)), square
