"""Pieces of photographs in filled shapes: grey objects."""

from __future__ import annotations

import numpy as np
from skimage.transform import resize

from correlograph.lags import OBJECT_SIDE
from data_gen.shapes import filled_shape

SHARE = (0.4, 1.0)
"""Range of the side of a piece, as a fraction of the shorter side of its photograph."""


def piece(luminance: np.ndarray, rng: np.random.Generator, side: int = OBJECT_SIDE) -> np.ndarray:
    """Return a random piece of a photograph (H, W), uint8, within a random shape: albedo, float32 (side, side), maximum 1."""
    length = int(min(luminance.shape) * rng.uniform(*SHARE))
    top, left = (rng.integers(size - length + 1) for size in luminance.shape)
    cut = luminance[top : top + length, left : left + length].astype(np.float32)
    seen = resize(cut, (side, side), anti_aliasing=True) * (filled_shape(rng, side) > 0)
    return (seen / max(float(seen.max()), 1.0)).astype(np.float32)
