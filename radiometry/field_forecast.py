"""Forecast of the retrieval of fields: whether the light suffices, which cells it shows, and what it costs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

MIN_PHOTONS_PER_GRAIN = 4.3
"""Photons per speckle grain of the object's bounding box above which fields improve the albedo. Evidence: docs/fields.md."""

MIN_ALBEDO = 0.03
"""Fraction of the maximum of an albedo above which a pixel belongs to the object."""

BOX_MARGIN_LAGS = 1.5
"""Margin of the object's bounding box, in lags of the albedo."""

MIN_CAMERA_GRAIN_PIXELS = 2.0
"""Minimum speckle grain of the bounding box in camera pixels; with smaller grains the intensity is undersampled (Nyquist)."""

MAX_FIELD_FRAMES = 64
"""Maximum number of frames whose fields are retrieved; 64 looks have a contrast of 0.125."""

Box = tuple[tuple[float, float], tuple[float, float]]
"""First and last position (rows, columns) of an object in pixels of its albedo."""

CPU_S_PER_SAMPLE = 2.5e-5
"""CPU time per frame and sample of the periodic grid on one core of 2024; it predicts times only."""

PIXELS_PER_GRAIN = 2.75
"""Mean number of binned pixels across a grain of the bounding box."""


@dataclass(frozen=True)
class FieldForecast:
    """Expected retrieval of the fields of a capture.

    Attributes:
        photons_per_grain: photoelectrons of a frame per speckle grain of the object's bounding box; other noise counts as if it lowered
            the light.
        needed_photons_per_grain: least number at which fields improve the albedo.
        cells_m: width of a cell of the field on the object along rows and columns; None if the camera is unknown.
        looks: number of independent speckle patterns of the fine albedo.
        cpu_s: CPU time on one core.
        resolution_m: half of the period that the mean |E|^2 resolves before it is despeckled; None if the object is unknown.
    """

    photons_per_grain: float
    needed_photons_per_grain: float
    cells_m: tuple[float, float] | None
    looks: int
    cpu_s: float
    resolution_m: float | None = None

    @property
    def suffices(self) -> bool:
        """Whether the light suffices."""
        return self.photons_per_grain >= self.needed_photons_per_grain

    def as_dict(self) -> dict[str, Any]:
        """Return the forecast for JSON."""
        return vars(self) | {"suffices": self.suffices}

    def describe(self) -> str:
        """Return the forecast in one line."""
        cells = "" if self.cells_m is None else ", cells of {:.0f} x {:.0f} um".format(*(1e6 * cell for cell in self.cells_m))
        verdict = "enough" if self.suffices else "too few"
        looks = "1 look" if self.looks == 1 else f"{self.looks} looks"
        resolution = "" if self.resolution_m is None else f" resolving {1e6 * self.resolution_m:.0f} um before despeckling"
        digits = 1 if self.photons_per_grain < 10.0 else 0
        photons = f"{self.photons_per_grain:.{digits}f} photons per grain of the object's box"
        light = f"{photons} ({self.needed_photons_per_grain:g} needed: {verdict})"
        return f"{light}{cells}, {looks}{resolution}, {self.cpu_s:.2g} CPU s"


def bounding_box(albedo: np.ndarray) -> Box:
    """Return the bounding box of the object of an albedo that is not zero, with a margin."""
    bright = np.argwhere(albedo > MIN_ALBEDO * albedo.max())
    first, last = bright.min(0) - BOX_MARGIN_LAGS, bright.max(0) + BOX_MARGIN_LAGS
    return (float(first[0]), float(first[1])), (float(last[0]), float(last[1]))


def forecast_fields(
    albedo: np.ndarray,
    floor_over_peak: float | None,
    frames: int,
    frame_shape: tuple[int, int],
    patch_shape: tuple[int, int],
    pitches_m: tuple[float, float] | None = None,
) -> FieldForecast | None:
    """Return the forecast for an albedo with one pixel per lag of a patch; None without an object, without light, and for grains that
    the camera undersamples.

    The floor over the peak is one over the photons per coherence area, (lambda z)^2 sum r^2 / (sum r)^2; a grain of the bounding box
    has the area (lambda z)^2 over that of the box.
    """
    if not albedo.any() or floor_over_peak is None or floor_over_peak <= 0.0:
        return None
    box = np.ptp(np.array(bounding_box(albedo)), axis=0)
    if min(patch / lags for patch, lags in zip(patch_shape, box, strict=True)) < MIN_CAMERA_GRAIN_PIXELS:
        return None
    filled = float(albedo.sum(dtype=np.float64) ** 2 / (albedo.astype(np.float64) ** 2).sum()) / float(box.prod())
    looks = min(frames, MAX_FIELD_FRAMES)
    samples = math.prod(
        side * PIXELS_PER_GRAIN * lags / patch for side, lags, patch in zip(frame_shape, box, patch_shape, strict=True)
    )
    cells = None if pitches_m is None else cells_of(pitches_m, frame_shape, patch_shape)
    return FieldForecast(filled / floor_over_peak, MIN_PHOTONS_PER_GRAIN, cells, looks, looks * samples * CPU_S_PER_SAMPLE)


def cells_of(pitches_m: tuple[float, float], frame_shape: tuple[int, int], patch_shape: tuple[int, int]) -> tuple[float, float]:
    """Return the width of a cell of the fields along rows and columns; a lag is wider by the ratio of frame and patch."""
    rows, columns = (pitch * patch / side for pitch, patch, side in zip(pitches_m, patch_shape, frame_shape, strict=True))
    return rows, columns
