"""Blend of the fine albedo with the coarse one, by their errors at the scale of a lag, as if these were independent.

With few looks and few cells per lag, the speckle of the fields leaves larger errors than the autocorrelation, which has many degrees of
freedom.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import zoom


def enlarge_albedo(coarse: np.ndarray, cells: int) -> np.ndarray:
    """Interpolate an albedo (n, n) to `cells` pixels per lag along both axes, float64, zero or more."""
    return zoom(coarse.astype(np.float64), cells, order=3, mode="grid-constant", grid_mode=True).clip(0.0)


def blend_with_coarse(
    fine: np.ndarray, coarse: np.ndarray, looks_per_lag: float, confidence: float
) -> tuple[np.ndarray, float]:
    """Return the weighted mean of both albedos (k n, k n), float32, and the weight of the fine one.

    An image with errors of variance e in units of its own variance correlates with the truth by c = (1 + e)^(-1/2). The predicted c of
    the coarse albedo therefore gives e = 1 / c^2 - 1. The fine albedo has the variance r^2 over the looks in a lag. The weights are
    inverse to these variances.

    Args:
        fine: albedo from fields (k n, k n).
        coarse: albedo from the autocorrelation (n, n), k times coarser, in the same position.
        looks_per_lag: frames times modes times cells per lag.
        confidence: predicted correlation of the coarse albedo with the truth.
    """
    enlarged = enlarge_albedo(coarse, len(fine) // len(coarse))
    square = float((enlarged**2).mean())
    error = 1.0 / max(confidence, 1e-3) ** 2 - 1.0
    speckle = square / max(float(enlarged.var()), 1e-30) / looks_per_lag
    weight = error / (error + speckle)
    gain = float((enlarged * fine).mean()) / max(square, 1e-30)
    return (weight * fine + (1.0 - weight) * gain * enlarged).astype(np.float32), weight
