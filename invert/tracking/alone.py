"""r*r of one moving object among several, from pairs of frames.

Moved back along the path of an object, two frames share its speckle, while that of the others has moved on. The mean cross-spectrum of such
pairs, b_k for object k, holds no noise of the camera, and of the other objects what their relative displacements leave. At each lag

    b_k = sum over l of A_kl S_l,    A_kl = sum over pairs of c_k c_l cos(2 pi f (D_k - D_l)) / sum over pairs of c_k^2

with the power S_l of object l, its displacement D_l between the frames of a pair, and the share c_l of its speckle that is still common.
These equations are solved for S. Near zero lag all objects look alike; each then gets its share of the whole r*r. The
interference of two objects, which moves at the mean of their paths, is left out; it averages to zero as they move apart.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import product

import numpy as np
import torch
from tqdm import tqdm

from correlograph.errors import InputError, memory_bytes
from correlograph.files.capture import Capture
from invert.measure.estimate import Estimate, apply_blur_transfer, camera_transfer, choose_grid
from invert.request import Request
from invert.tracking.track import Track
from radiometry.autocorrelation import PatchGrid
from radiometry.estimation.autocorrelation_estimator import (
    AutocorrelationEstimator,
    degrees_of_freedom,
    estimate_autocorrelation,
)
from radiometry.estimation.background import BackgroundRecord
from radiometry.noise.measured_noise import outermost_signal_ring

MIN_IN_COMMON = 0.2
"""Least speckle in common, over the most of an object, of pairs of frames that are used."""

BYTES_PER_PIXEL = 4
"""Memory of the spectrum of a padded frame, per pixel."""

ROUNDS = 3
"""Rounds in which the part of each object is measured from what the round before has found."""

MIN_FLOOR_FRACTION = 0.1
"""Least value of the estimate over its floor, because estimates are positive."""


@dataclass(frozen=True)
class Mixture:
    """Frames in which several objects move.

    Attributes:
        frames: (H, W) each.
        tracks: paths of the objects.
    """

    frames: Sequence[np.ndarray]
    tracks: Sequence[Track]

    @cached_property
    def in_common(self) -> np.ndarray:
        """Share of the speckle of each object that frames 1, 2, ... apart have in common, over the largest, (objects, distances)."""
        shares = np.stack([one.in_common / max(float(one.in_common.max()), 1e-9) for one in self.tracks])
        shares = np.where(shares > MIN_IN_COMMON, shares, 0.0)
        shares[~shares.any(1), 0] = 1.0  # too faint for a measurement
        return shares

    @property
    def light(self) -> np.ndarray:
        """Approximate part of each object in the power of the speckle, (objects,)."""
        shares = np.array([max(float(one.in_common.max()), 1e-9) for one in self.tracks])
        return shares / shares.sum()

    def dof(self, number: int, grid: PatchGrid) -> float:
        """Return the degrees of freedom K of an object: those of a frame times the number of independent patterns that it shows, times
        its part of the light, because the speckle of the others is noise in its pairs."""
        shares = self.in_common[number]
        # Beyond the distances that were measured, the likeness falls on as over the last ones.
        last = shares[-1] ** 2
        fall = min(last / max(shares[len(shares) // 2] ** 2, 1e-9), 0.99) ** (2.0 / len(shares))
        alike = float((shares**2).sum() + last * fall / (1.0 - fall))
        patterns = max(1.0, len(self.frames) / (1.0 + 2.0 * alike))
        return max(1.0, patterns * self.light[number] * degrees_of_freedom(1, grid.frame_shape, grid.patch_shape))

    def along(self, number: int, grid: PatchGrid) -> np.ndarray:
        """Return b of an object at the lags of a grid, in units of an estimate."""
        shares = self.in_common[number]
        estimator = AutocorrelationEstimator(grid, mean="pooled")
        needed = (len(shares) + 3) * BYTES_PER_PIXEL * math.prod(estimator.padded)
        if needed > memory_bytes():
            found = f"{needed / 1e9:.1f} GB for pairs of frames"
            raise InputError(
                "frames", f"at most {memory_bytes() / 1e9:.1f} GB", found, "bin the frames, or cut out a part of them"
            )
        earlier: deque[torch.Tensor] = deque(maxlen=int(np.flatnonzero(shares)[-1]) + 1)  # the latest first
        total, weight = torch.zeros(1), 0.0
        shown = zip(self.frames, self.tracks[number].path_pixels, strict=True)
        for frame, place in tqdm(shown, desc="pairs", total=len(self.frames), unit="frame", disable=None, leave=False):
            image = torch.from_numpy(np.asarray(frame, np.float32))
            moved = estimator.move_back(estimator.spectrum_of(image, float(image.mean()))[0], place.tolist())
            partners = torch.zeros_like(moved)
            for share, other in zip(shares.tolist(), earlier, strict=False):
                partners.add_(other, alpha=share)
                weight += share**2
            total = total + (partners.conj() * moved).real
            earlier.appendleft(moved)
        return estimator.at_lags(total / weight)

    def mixing(self, grid: PatchGrid) -> np.ndarray:
        """Return the matrix A at each lag, (side, side, objects, objects)."""
        count, side = len(self.tracks), grid.lag_grid.side
        found = np.zeros((side, side, count, count))
        for one, other in product(range(count), repeat=2):
            relative = self.tracks[one].path_pixels - self.tracks[other].path_pixels
            for apart, common in enumerate(self.in_common[one] * self.in_common[other], 1):
                if common:
                    found[:, :, one, other] += common * _interference(relative[apart:] - relative[:-apart], grid)
        return found / np.diagonal(found, axis1=2, axis2=3)[..., None]

    def separate(self, number: int, grid: PatchGrid, joint: np.ndarray) -> np.ndarray:
        """Return the power S of an object at the lags of a grid.

        Args:
            joint: power of all objects at these lags.
        """
        along = np.stack([self.along(one, grid) for one in range(len(self.tracks))], -1)
        # A prior of the part of each object in the whole, with a standard error of its own size, decides where the equations do not.
        prior = np.diag([1.0 / (self.dof(one, grid) * part) for one, part in enumerate(self.light)])
        mixing, light = self.mixing(grid) + prior, self.light
        for _ in range(ROUNDS):
            found = np.linalg.solve(mixing, (along + (joint[..., None] * light) @ prior)[..., None])[..., 0]
            power = np.maximum(found.sum((0, 1)), 1e-9 * joint.sum())
            light = power / power.sum()
        return found[..., number]


def _interference(away: np.ndarray, grid: PatchGrid) -> np.ndarray:
    """Return the sum of cos(2 pi f D) over relative displacements D (pairs, 2) at the lags of a grid, as the estimator sees it."""
    steps = np.arange(-grid.lags, grid.lags + 1)
    rows, columns = (
        np.exp(2j * np.pi * np.outer(steps, along) / side) for along, side in zip(away.T, grid.patch_shape, strict=True)
    )
    # The window of a patch, over the fraction of pixels with a partner, by which lags are divided.
    in_patches, in_frames = (np.abs(away) / np.array(shape) for shape in (grid.patch_shape, grid.frame_shape))
    seen = np.prod(np.maximum(1.0 - in_patches, 0.0) / np.maximum(1.0 - in_frames, 0.1), 1)
    return ((rows * seen) @ columns.T).real


def estimate_alone(capture: Capture, tracks: Sequence[Track], number: int, request: Request, joint: Estimate) -> Estimate:
    """Estimate r*r of one object from frames in which several move.

    Args:
        tracks: paths of all objects.
        number: index of the object.
        joint: the pooled estimate of all objects together, whose record and drawing are kept.
    """
    begin, mixture = time.perf_counter(), Mixture(capture.frames, tracks)
    assert joint.record is not None
    known = {joint.record.grid: joint.values}

    @cache  # the grid that is chosen has already been tried
    def values_on(grid: PatchGrid) -> np.ndarray:
        whole = known[grid] if grid in known else estimate_autocorrelation(capture.frames, grid, "pooled")[0]
        separate = mixture.separate(number, grid, whole - float(whole[_beyond(grid)].mean()))
        return _add_floor(separate, grid, mixture.dof(number, grid))

    grid, reason = choose_grid(capture, request, values_on)
    camera = capture.camera.lag_geometry
    record = replace(
        joint.record,
        grid=grid,
        dof_expected=mixture.dof(number, grid),
        background=BackgroundRecord("pooled"),
        lags_reason=reason,
        contrast=None,  # objects that move apart lower it by themselves
        object_number=number + 1,
    )
    found = replace(
        joint,
        values=values_on(grid),
        transfer=camera_transfer(capture.camera, grid),
        blur_pixels=None,
        pitches_m=grid.lag_pitches_m(*camera) if camera else None,
        record=record,
        filtered_frames=None,
        seconds=joint.seconds + time.perf_counter() - begin,
    )
    blur = request.known_blur
    return found if blur is None else apply_blur_transfer(found, (blur, blur))


def _beyond(grid: PatchGrid) -> np.ndarray:
    """Return a mask of the lags beyond any object."""
    return grid.lag_grid.ring > outermost_signal_ring(grid.lag_grid)


def _add_floor(values: np.ndarray, grid: PatchGrid, dof: float) -> np.ndarray:
    """Return an estimate with the floor at which its noise is that of K degrees of freedom: the root of K times its standard deviation at
    the lags beyond any object."""
    beyond = values[_beyond(grid)]
    floor = float(beyond.std()) * dof**0.5
    return np.maximum(values - float(beyond.mean()) + floor, MIN_FLOOR_FRACTION * floor).astype(np.float32)
