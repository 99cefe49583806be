"""Offset of a camera from its frames: where a frame equals the offset, shot noise and speckle vanish."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from radiometry.estimation.noise_curve import noise_curve

SIGNIFICANT_SIGMA = 5.0
"""Standard errors by which an offset must exceed zero; by chance once in three million captures."""

MAX_ERROR = 0.1
"""Maximum standard error of an offset in units of the light that remains above it."""

BLOCKS = 8
"""Blocks along each axis in which light and speckle are compared."""


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
    return _if_known(offset, error, light)


def offset_from_speckle(frames: Sequence[np.ndarray]) -> float | None:
    """Return the offset of unevenly lit frames (H, W) in their unit; None if their speckle does not determine it.

    Speckle of one object has the same contrast k everywhere, so that its standard deviation in a block is k (mean - offset). It follows
    from the covariance of diagonal neighbours, to which noise of pixels, rows and columns adds nothing. The speckle of a block moves
    mean and deviation together; polynomials of the position are therefore the instruments of the fit (two-stage least squares).
    """
    means, deviations = np.mean([_light_and_speckle(frame) for frame in frames], 0)
    place = (np.arange(BLOCKS) + 0.5) / BLOCKS - 0.5
    row, column = (axis.ravel() for axis in np.meshgrid(place, place, indexing="ij"))
    instruments = np.stack([np.ones_like(row), row, column, row**2, row * column, column**2], 1)
    regressors = np.stack([np.ones_like(means), means], 1)
    smooth = instruments @ np.linalg.lstsq(instruments, regressors, rcond=None)[0]
    inverse = np.linalg.pinv(smooth.T @ smooth)
    constant, contrast = inverse @ smooth.T @ deviations
    residual = deviations - regressors @ (constant, contrast)
    covariance = inverse * float(residual @ residual) / (len(means) - 2)
    if contrast <= SIGNIFICANT_SIGMA * covariance[1, 1] ** 0.5:
        return None
    offset = -constant / contrast
    slopes = np.array([-1.0, -offset]) / contrast
    error, light = float((slopes @ covariance @ slopes) ** 0.5), float(means.mean()) - offset
    return _if_known(offset, error, light)


def _if_known(offset: float, error: float, light: float) -> float | None:
    """Return an offset that is significant, and precise in units of the light above it; None for any other."""
    return float(offset) if offset > SIGNIFICANT_SIGMA * error and light > 0.0 and error < MAX_ERROR * light else None


def _light_and_speckle(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of the speckle in each block of a frame (H, W)."""
    rows, columns = (side // BLOCKS for side in frame.shape)
    cut = np.asarray(frame, np.float64)[: rows * BLOCKS, : columns * BLOCKS]
    blocks = cut.reshape(BLOCKS, rows, BLOCKS, columns).swapaxes(1, 2).reshape(-1, rows, columns)
    means = blocks.mean((1, 2))
    above = blocks - means[:, None, None]
    shared = 0.5 * ((above[:, 1:, 1:] * above[:, :-1, :-1]).mean((1, 2)) + (above[:, 1:, :-1] * above[:, :-1, 1:]).mean((1, 2)))
    return means, np.sqrt(shared.clip(0.0))
