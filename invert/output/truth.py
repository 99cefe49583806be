"""Known albedo to compare a reconstruction with, resampled to the lags of the reconstruction."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from correlograph.errors import InputError, check_positive
from correlograph.files.capture import Capture
from correlograph.files.capture_folder import check_complete
from correlograph.files.images import read_image
from invert.albedo.metrics import aligned_pearson

SAME_PITCH = 0.01
"""Relative difference up to which two pitches count as equal."""


@dataclass(frozen=True)
class Truth:
    """A known albedo, non-negative, and its pixel pitch along rows and columns (None if unknown).

    An albedo of known pitch is padded to a square; one without has a pixel per lag and must be square.
    """

    albedo: np.ndarray
    pitches_m: tuple[float, float] | None = None
    name: str = "the array"

    def __post_init__(self) -> None:
        """Raise InputError for anything else."""
        array = np.asarray(self.albedo)
        is_image = array.ndim == 2 and array.size > 0 and array.dtype.kind in "uifb"
        if self.pitches_m is not None:
            pitches = self.pitches_m if isinstance(self.pitches_m, Sequence) else (self.pitches_m, self.pitches_m)
            if len(pitches) != 2:
                raise InputError("pitches_m", "the pitch along rows and along columns", f"{pitches!r:.60}", "give two numbers")
            object.__setattr__(self, "pitches_m", tuple(check_positive("pitches_m", pitch) for pitch in pitches))
            if is_image:
                margins = [(max(array.shape) - side) // 2 for side in array.shape]
                array = np.pad(
                    array, [(low, max(array.shape) - side - low) for low, side in zip(margins, array.shape, strict=True)]
                )
        is_square = is_image and array.shape[0] == array.shape[1]
        if not is_square or not np.isfinite(array).all() or (array < 0).any():
            expected = "a square albedo, one pixel per lag, zero or more"
            found = f"shape {array.shape} in {self.name}" if not is_square else f"negative or infinite values in {self.name}"
            raise InputError("--truth", expected, found, "resample it to the lag pitch, or give its own (--truth-pitch-m)")
        object.__setattr__(self, "albedo", array.astype(np.float32))

    @classmethod
    def read(cls, path: str | Path, pitch_m: float | None = None) -> Truth:
        """Read a truth; its pitch, if it is not given, is in the sim.json beside it, if there is one. Raises
        InputError for anything else.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError("--truth", "an albedo, one pixel per lag", f"no {path}", "check the path")
        check_complete(path.parent)
        albedo, _ = read_image(path)
        if pitch_m is None:
            return cls(albedo, _recorded_pitches(path.with_name("sim.json")), path.name)
        return cls(albedo, (pitch_m, pitch_m), path.name)

    @classmethod
    def of(cls, capture: Capture) -> Truth:
        """Return the truth of a rendered capture. Raises InputError for anything else."""
        if not isinstance(capture, Capture):
            raise InputError("capture", "a rendered capture", f"{type(capture).__name__}", "create a Truth from the array")
        if capture.truth is None:
            raise InputError("capture", "a rendered capture", "one without truth", "provide the albedo as an array")
        return cls(capture.truth, tuple(capture.record["lag_pitches_m"]) if "lag_pitches_m" in capture.record else None)

    def on_lags(self, side: int, pitches_m: tuple[float, float] | None) -> np.ndarray:
        """Return the albedo averaged over the cells of a grid (side, side) with the same centre. Raises InputError without a
        pitch.
        """
        known = self.pitches_m is not None and pitches_m is not None
        same = known and all(abs(ours - own) <= SAME_PITCH * own for ours, own in zip(pitches_m, self.pitches_m, strict=True))
        if self.albedo.shape == (side, side) and (same or not known):
            return self.albedo
        if not known:
            found = f"shape {self.albedo.shape} in {self.name}"
            remedy = "give its pitch (--truth-pitch-m, or correlograph.Truth)"
            raise InputError("--truth", f"a {side} x {side} albedo, one pixel per lag", found, remedy)
        rows, columns = (
            _overlap(side, pitch, len(self.albedo), own) for pitch, own in zip(pitches_m, self.pitches_m, strict=True)
        )
        return (rows @ self.albedo @ columns.T).astype(np.float32)


@dataclass(frozen=True)
class Comparison:
    """An albedo registered to a truth, the truth on the same pixels, and their Pearson correlation."""

    pearson: float
    albedo: np.ndarray
    truth: np.ndarray


def compare_fine(albedo: np.ndarray, pitches_m: tuple[float, float] | None, known: Truth, cells: int) -> Comparison:
    """Compare an albedo whose pixels are finer than those of a truth, after registration, on the pixels of the truth.

    Args:
        cells: pixels of the albedo per lag, for a truth of unknown pitch, which has one pixel per lag.
    """
    if pitches_m is None or known.pitches_m is None:
        on_lags = known.on_lags(len(albedo) // cells, None)
        own = (1.0, 1.0)
        known, pitches_m = Truth(on_lags, own, known.name), (1.0 / cells, 1.0 / cells)
    shown = known.on_lags(len(albedo), pitches_m)
    pearson, moved = aligned_pearson(albedo, shown)
    if min(known.pitches_m or pitches_m) > max(pitches_m):
        means = Truth(moved.clip(0.0), pitches_m).on_lags(len(known.albedo), known.pitches_m)
        pearson = float(np.corrcoef(means.ravel(), known.albedo.ravel())[0, 1])
    return Comparison(pearson, moved, shown)


def _overlap(side: int, pitch_m: float, own_side: int, own_pitch_m: float) -> np.ndarray:
    """Return the fraction of each grid cell that each cell of the truth covers along one axis, (side, own_side)."""
    edges = (np.arange(side + 1) - side / 2) * pitch_m
    own = (np.arange(own_side + 1) - own_side / 2) * own_pitch_m
    low, high = np.maximum(edges[:-1, None], own[None, :-1]), np.minimum(edges[1:, None], own[None, 1:])
    return (high - low).clip(0.0) / pitch_m


def _recorded_pitches(record: Path) -> tuple[float, float] | None:
    """Return the pitches of a truth from the record of its capture; None without one."""
    if not record.is_file():
        return None
    try:
        content = json.loads(record.read_text())
        if not isinstance(content, dict) or "lag_pitch_m" not in content:
            return None  # the file of another program
        down, right = map(float, content.get("lag_pitches_m", [content["lag_pitch_m"]] * 2))
        if not (np.isfinite([down, right]).all() and min(down, right) > 0.0):
            raise ValueError(f"pitches {down}, {right}")
    except (OSError, ValueError, TypeError, RecursionError) as error:
        found = f"{type(error).__name__} in {record}"
        raise InputError("--truth", "a capture's record beside it that can be read", found, "remove or repair it") from None
    return down, right
