"""Statistics of frames behind a mask, which hold their mean where they were not measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

MASK_LAGS = 8
"""Lags within which the edges of a mask may spread the power of a lag; r*r changes little over so many."""

BLOCKS = 8
"""Blocks along each side of a frame."""

MIN_KEPT = 0.5
"""Blocks with less than this share of the power of the fullest one are left out."""


@dataclass(frozen=True)
class Kept:
    """Statistics of a mask's density, averaged over `MASK_LAGS`: the rest of its spectrum is spread over all lags like noise.

    Attributes:
        power: share of the power at a lag that is left: that of the pixels if these lie together, its square if they are scattered.
        patterns: share of the degrees of freedom that are left: that of the pixels if these lie together, 1 if they are scattered.
        blocks: by exponent, 2 and 3, the share of this power of filtered frames that is left in each block, (8, 8).
    """

    power: float
    patterns: float
    blocks: dict[int, np.ndarray]

    @classmethod
    def of(cls, measured: np.ndarray, patch_shape: tuple[int, int]) -> Kept:
        """Return those of a mask (H, W) of pixels that were measured, not zero there."""
        sides = [max(1, side // (2 * MASK_LAGS)) for side in patch_shape]
        density = uniform_filter((np.asarray(measured) != 0).astype(np.float64), sides)
        power, (height, width) = density**2, (side // BLOCKS for side in density.shape)
        cells = density[: height * BLOCKS, : width * BLOCKS].reshape(BLOCKS, height, BLOCKS, width)
        blocks = {exponent: np.maximum((cells**exponent).mean((1, 3)), 1e-6) for exponent in (2, 3)}
        return cls(float(power.mean()), float(power.mean() ** 2 / (power**2).mean()), blocks)

    @property
    def is_used(self) -> np.ndarray:
        """Blocks that are full enough, bool (8, 8)."""
        return self.blocks[2] >= MIN_KEPT * self.blocks[2].max()
