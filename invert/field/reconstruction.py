"""Fine albedo from the fields of a capture, with its resolution, its standard deviation and its certificate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.ranges import CELLS_PER_LAG
from invert.field.certificate import Certificate
from invert.field.field import Field


@dataclass(frozen=True)
class FieldReconstruction:
    """Fine albedo of a capture.

    Attributes:
        albedo: despeckled mean intensity of the fields on the window of the coarse albedo, float32 (k n, k n), maximum 1.
        cells_per_lag: k, the number of pixels per lag.
        certificate: whether the fields predict held-out pixels.
        looks: number of fields: frames times polarisation modes.
        frames: number of frames whose fields were retrieved.
        weight: weight of the fields at the scale of a lag (`invert.field.blending`); the rest is the coarse albedo.
        resolution_lags: half of the finest period that two halves of the frames share, in lags; None for one frame, if the fields with
            the coarse albedo as prior were not accepted, and if much of the coarse albedo is still in the fine one (`coarse_weight`).
        agreement: correlation of the albedos from two halves of the frames; None like the resolution.
        photons_per_grain: expected photoelectrons per frame and speckle grain of the object's bounding box.
        background_fraction: fraction of the light that does not come from the object.
        coarse_weight: weight that the coarse albedo, as the first prior, still has in the mean intensity of the fields.
        deviation: standard deviation of the albedo, from halves of the frames, like `albedo`; None for one frame.
        intensity: mean intensity of the fields before despeckling, like `albedo`; None for a loaded result.
        field: field of each frame; None for a loaded result.
    """

    albedo: np.ndarray
    cells_per_lag: int
    certificate: Certificate
    looks: int
    frames: int
    weight: float
    resolution_lags: float | None
    agreement: float | None
    photons_per_grain: float
    background_fraction: float
    coarse_weight: float
    deviation: np.ndarray | None = None
    intensity: np.ndarray | None = None
    field: Field | None = None

    @property
    def confidence(self) -> float | None:
        """Predicted correlation of the albedo with the truth on its own pixels; None like the resolution.

        If two halves correlate by a, their mean correlates with its expectation by sqrt(2 a / (1 + a)) (Spearman and Brown;
        Rosenthal and Henderson, doi:10.1016/j.jmb.2003.07.013, Eq. 14).
        """
        agreement = self.agreement and max(self.agreement, 0.0)
        return agreement if agreement is None else (2.0 * agreement / (1.0 + agreement)) ** 0.5

    def resolution_m(self, lag_pitches_m: tuple[float, float] | None) -> float | None:
        """Return the resolution in metres; None if it or the lag pitch is unknown."""
        if self.resolution_lags is None or lag_pitches_m is None:
            return None
        return self.resolution_lags * max(lag_pitches_m)

    def describe(self, lag_pitches_m: tuple[float, float] | None) -> str:
        """Return resolution, number of looks and certificate in a few words."""
        resolution = self.resolution_m(lag_pitches_m)
        parts = [] if resolution is None else [f"resolution {resolution * 1e6:.0f} um"]
        parts += [] if self.confidence is None else [f"confidence at this resolution {self.confidence:.3f}"]
        looks = "1 look" if self.looks == 1 else f"{self.looks} looks"
        return ", ".join([*parts, looks, f"held-out pixels predicted at {self.certificate.gain_sigma:.0f} sigma"])

    def as_dict(self, lag_pitches_m: tuple[float, float] | None) -> dict[str, Any]:
        """Return the quantities for JSON."""
        return {
            "cells_per_lag": self.cells_per_lag,
            "looks": self.looks,
            "frames": self.frames,
            "weight_at_lags": self.weight,
            "agreement": self.agreement,
            "confidence": self.confidence,
            "photons_per_grain": self.photons_per_grain,
            "background_fraction": self.background_fraction,
            "coarse_weight": self.coarse_weight,
            "resolution_lags": self.resolution_lags,
            "resolution_m": self.resolution_m(lag_pitches_m),
            "certificate": self.certificate.as_dict(),
        }

    @classmethod
    def load(cls, folder: Path, albedo: np.ndarray, summary: dict[str, Any]) -> FieldReconstruction:
        """Return the reconstruction that `as_dict` described. Raises ValueError, KeyError or TypeError for damaged content."""
        cells = CELLS_PER_LAG.check("cells_per_lag", summary["cells_per_lag"])
        file = folder / "deviation.npy"
        deviation = np.load(file, allow_pickle=False) if file.is_file() else None
        for name, image in (("albedo.npy", albedo), ("deviation.npy", deviation)):
            is_whole = image is None or (image.shape == albedo.shape and image.dtype.kind == "f" and np.isfinite(image).all())
            if not is_whole or albedo.ndim != 2 or len(albedo) % cells:
                raise ValueError(name)
        return cls(
            albedo,
            cells,
            Certificate.from_dict(summary["certificate"]),
            int(summary["looks"]),
            int(summary["frames"]),
            float(summary["weight_at_lags"]),
            *(None if summary[name] is None else float(summary[name]) for name in ("resolution_lags", "agreement")),
            float(summary["photons_per_grain"]),
            *(float(summary[name]) for name in ("background_fraction", "coarse_weight")),
            deviation,
        )
