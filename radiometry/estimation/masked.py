"""Statistics of frames behind a mask, which hold their mean where they were not measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

MASK_LAGS = 8
"""Lags within which the edges of a mask may spread the power of a lag; r*r changes little over so many."""

MIN_KEPT = 0.5
"""Blocks with less than this share of the power of the fullest one are left out."""


@dataclass(frozen=True)
class Kept:
    """Statistics of a mask's density, averaged over `MASK_LAGS`: the rest of its spectrum is spread over all lags like noise.

    Attributes:
        power: share of the power at a lag that is left: that of the pixels if these lie together, its square if they are scattered.
        patterns: share of the degrees of freedom that are left: that of the pixels if these lie together, 1 if they are scattered.
        squares, cubes: shares of squares and cubes of filtered frames that are left in each block, (blocks, blocks).
    """

    power: float
    patterns: float
    squares: np.ndarray
    cubes: np.ndarray

    @classmethod
    def of(cls, measured: np.ndarray, patch_shape: tuple[int, int], blocks: int) -> Kept:
        """Return those of a mask (H, W) of pixels that were measured, not zero there."""
        sides = [max(1, side // (2 * MASK_LAGS)) for side in patch_shape]
        density = uniform_filter((np.asarray(measured) != 0).astype(np.float64), sides)
        height, width = (side // blocks for side in density.shape)

        def in_blocks(values: np.ndarray) -> np.ndarray:
            return values[: height * blocks, : width * blocks].reshape(blocks, height, blocks, width).mean((1, 3))

        power = density**2
        patterns = float(power.mean() ** 2 / (power**2).mean())
        return cls(float(power.mean()), patterns, in_blocks(power), in_blocks(density**3))

    @property
    def is_used(self) -> np.ndarray:
        """Blocks that are full enough, bool (blocks, blocks)."""
        return self.squares >= MIN_KEPT * self.squares.max()
