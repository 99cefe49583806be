"""Offset of a camera, from the noise of its frames: the variance of shot noise vanishes where the frame equals the offset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from radiometry.estimation.noise_curve import noise_curve

SIGNIFICANT_SIGMA = 5.0
"""Standard errors by which an offset must exceed zero; by chance once in three million captures."""

MAX_ERROR = 0.1
"""Maximum standard error of an offset in units of the light that remains above it."""


def camera_offset(frames: Sequence[np.ndarray]) -> float | None:
    """Return the offset of frames (H, W) of one camera setting in their unit; None if their noise does not determine one.

    The noise curve is gain (I - offset) + read noise, so that read noise of s electrons lowers the estimate by gain s^2.
    """
    images = [torch.as_tensor(np.ascontiguousarray(frame, np.float32)) for frame in frames]
    curve = noise_curve(images, [torch.ones_like(image, dtype=torch.bool) for image in images])
    if curve.coefficients[2] < 3.0 * curve.errors[2]:
        curve = curve.given(2, 0.0)
    constant, gain, _ = curve.coefficients
    if gain <= SIGNIFICANT_SIGMA * curve.errors[1]:
        return None
    offset = -constant / gain
    slopes = np.array([-1.0, -offset, 0.0]) / gain
    error = float(np.sqrt(max(slopes @ curve.covariance @ slopes, 0.0)))
    light = float(np.mean([float(image.mean()) for image in images])) - offset
    is_known = offset > SIGNIFICANT_SIGMA * error and light > 0.0 and error < MAX_ERROR * light
    return float(offset) if is_known else None
