"""What a scene's frames will show: noise terms, floor over peak, degrees of freedom, known r*r.

Takes a `sim.geometry.Geometry`, without importing the simulator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from radiometry.autocorrelation import LAGS, PatchGrid, autocorrelate, automatic_patch_size, patch_grid, window_smooth
from radiometry.noise_budget import NoiseTerms, degrees_of_freedom
from radiometry.photons import grain_area
from radiometry.throughput import closed_form
from radiometry.transfer import lag_transfer

CELLS_PER_LAG = 4
"""Fineness of the albedo from which the known r*r is made."""


@dataclass(frozen=True)
class Prediction:
    """Expected estimate of a scene, for patches of `grid`.

    Attributes:
        signal: H (r*r), window-smoothed, (127, 127), in units of (r*r)(0).
        transfer: H per lag (127, 127).
        shot_floor_over_peak: one over the photoelectrons per coherence area; None without light.
    """

    terms: NoiseTerms
    grid: PatchGrid
    pitch_m: float
    signal: np.ndarray
    transfer: np.ndarray

    @property
    def shot_floor_over_peak(self) -> float | None:
        return self.terms.over_peak()["signal"]

    def dof(self, frames: int) -> int:
        return degrees_of_freedom(frames, self.grid.count)

    def signal_to_noise(self, frames: int) -> float | None:
        """Signal over standard deviation, averaged (by signal) over the lags of the object; None without light."""
        floor = self.terms.floor_over_peak()
        if floor is None:
            return None
        weight = self.signal / self.signal.sum()
        return float((weight * self.signal / (self.signal + floor)).sum()) * math.sqrt(self.dof(frames))


def noise_terms(geometry: Any, albedo: np.ndarray, cell_m: float) -> NoiseTerms:
    """Noise terms of one frame of a scene.

    Args:
        albedo: the object's albedo on square cells of `cell_m`.
    """
    electronics = geometry.electronics
    pixel_area = geometry.pixel_pitch_m**2
    grain = grain_area(albedo, cell_m**2, geometry.wavelength_m, geometry.distance_m)
    ambient = geometry.ambient_photoelectrons_per_pixel_s
    # Subjective grain of the wall behind a circular pupil: (lambda z)^2 / A (Goodman, Speckle Phenomena, Eq. 4-75).
    pupil_area = 0.25 * math.pi * geometry.pupil_diameter_m**2
    subjective_grain = (geometry.wavelength_m * geometry.pupil_distance_m) ** 2 / pupil_area
    return NoiseTerms(
        signal=closed_form(geometry.light_path).photoelectrons_per_pixel_s * electronics.exposure_s,
        # Two incoherent polarisations halve the speckle's variance.
        grain_pixels=grain / pixel_area * (0.5 if geometry.depolarised else 1.0),
        ambient=0.0 if ambient is None else float(ambient.mean()) * electronics.exposure_s,
        dark=electronics.dark_current * electronics.exposure_s,
        read=electronics.read_noise**2,
        quantisation=electronics.step**2 / 12.0,
        # Their mean square falls from 2 to 3/2, and the wall's own speckle has half the variance: 3/4 instead of 2.
        detector_grain_pixels=subjective_grain / pixel_area * (0.375 if geometry.depolarised else 1.0),
    )


def patches_of(geometry: Any, patch: int | None = None) -> tuple[PatchGrid, float]:
    """How frames of a scene are cut into patches of `patch` pixels (None: as `invert` would), and the lag pitch in metres."""
    facts = (geometry.wavelength_m, geometry.distance_m, geometry.pixel_pitch_m)
    grid = patch_grid(geometry.frame_shape, patch or automatic_patch_size(geometry.frame_shape, facts))
    return grid, grid.lag_pitch_m(*facts)


def predict(geometry: Any, patch: int | None = None) -> Prediction:
    """Predict what frames of a scene will show, cut into patches of `patch` pixels (None: as `invert` would)."""
    grid, pitch_m = patches_of(geometry, patch)
    cell = pitch_m / CELLS_PER_LAG
    side = max(64 * CELLS_PER_LAG, math.ceil(max(geometry.hidden_object.extent_m) / cell) + 1)
    albedo = geometry.hidden_object.sample((cell, cell), (side, side)).albedo
    lags = autocorrelate(albedo)
    transfer = lag_transfer(np.arange(-LAGS, LAGS + 1), pitch_m, geometry.distance_m, geometry.pixel_pitch_m,
                            geometry.pupil_diameter_m, geometry.wavelength_m, geometry.pupil_distance_m)
    signal = window_smooth(lags / lags.max() if lags.max() > 0.0 else lags, CELLS_PER_LAG) * transfer
    return Prediction(noise_terms(geometry, albedo, cell), grid, pitch_m, signal, transfer)
