"""Prediction for a scene: noise terms, floor over peak, degrees of freedom, known r*r.

The functions accept a `sim.geometry.Geometry`, but this module does not import the simulator.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from correlograph.lags import LAGS, lag_grid_of
from radiometry.autocorrelation import (
    PatchGrid,
    autocorrelate,
    automatic_patch_size,
    patch_grid,
    peak_of_cell_means,
    smooth_by_window,
)
from radiometry.estimation.autocorrelation_estimator import degrees_of_freedom
from radiometry.estimation.third_moment import MIN_SIGNAL_FRACTION, drawn_third_moment
from radiometry.field_forecast import FieldForecast, forecast_fields
from radiometry.light_budget_rows import light_budget
from radiometry.noise.detection import DETECTION_LIMIT, detection
from radiometry.noise.measured_noise import WHOLE_FRAME_INFLATION, NoiseLevel
from radiometry.noise.predicted_floor import NoiseTerms, estimate_error
from radiometry.photons import grain_area
from radiometry.transfer import lag_transfer

CELLS_PER_LAG = 4
"""Cells per lag of the albedo from which the known r*r is computed."""


@dataclass(frozen=True)
class Prediction:
    """Expected estimate of a scene, for patches of `grid`.

    Attributes:
        pitches_m: object distance of one lag along rows and columns.
        signal: H (r*r), smoothed by the window, (127, 127), in units of (r*r)(0).
        transfer: H per lag (127, 127), times the factor M of motion at each lag in units of that at zero lag.
        cells: the albedo (64, 64), one cell per lag; zero for a wider object.
        polarisations: number of incoherent patterns that share the light.
        shot_floor_over_peak: one over the photoelectrons per coherence area; None without light.
    """

    terms: NoiseTerms
    grid: PatchGrid
    pitches_m: tuple[float, float]
    signal: np.ndarray
    transfer: np.ndarray
    cells: np.ndarray
    polarisations: int

    @property
    def pitch_m(self) -> float:
        """Object distance of one lag along the row axis."""
        return self.pitches_m[0]

    @property
    def shot_floor_over_peak(self) -> float | None:
        return self.terms.over_peak()["signal"]

    def dof(self, frames: int) -> float:
        """Return K of an estimate from `frames` frames that have no static pattern."""
        return degrees_of_freedom(frames, self.grid.frame_shape, self.grid.patch_shape)

    def with_exposure_factor(self, factor: float) -> Prediction:
        """Return the prediction for exposures longer by a factor."""
        terms = self.terms
        longer = replace(
            terms,
            signal=terms.signal * factor,
            dark=terms.dark * factor,
            ambient=terms.ambient * factor,
            gates=terms.gates * factor,
        )
        return replace(self, terms=longer)

    def detection(self, frames: int) -> float:
        """Return the expected significance of the signal in standard deviations, as `invert` computes it from an estimate."""
        floor = self.terms.floor_over_peak()
        if floor is None:
            return 0.0
        noise = NoiseLevel(floor, self.dof(frames), self.grid.lag_grid.lags, WHOLE_FRAME_INFLATION)
        return detection(self.signal + floor, noise)

    def detection_factor(self, frames: int) -> float | None:
        """Return by which factor exposures must change for the object to be just detectable; None if no exposure suffices."""
        return self._least_factor(lambda longer: longer.detection(frames) / DETECTION_LIMIT)

    def error(self, frames: int) -> float | None:
        """Return the relative error of the estimate's signal, root mean square over all lags; None without light."""
        floor, signal = self.terms.floor_over_peak(), self.signal
        if floor is None:
            return None
        return estimate_error(float(signal.sum()), float((signal**2).sum()), signal.size, floor, self.dof(frames))

    def error_factor(self, frames: int, error: float) -> float | None:
        """Return by which factor exposures must change for an error of the estimate; None if no exposure suffices."""
        return self._least_factor(lambda longer: error / (longer.error(frames) or math.inf))

    def _least_factor(self, excess: Callable[[Prediction], float]) -> float | None:
        """Return the factor of the exposure at which `excess`, which grows with it, is 1."""

        def log_excess(octaves: float) -> float:
            return math.log(max(excess(self.with_exposure_factor(2.0**octaves)), 1e-300))

        lowest, highest = -40.0, 60.0
        if log_excess(highest) < 0.0:
            return None
        return 2.0 ** float(brentq(log_excess, lowest, highest, xtol=1e-3)) if log_excess(lowest) < 0.0 else 2.0**lowest

    def forecast_fields(self, frames: int) -> FieldForecast | None:
        """Return the forecast of `--method field`; None without light, and for an object wider than the lags."""
        floor, grid = self.terms.floor_over_peak(), self.grid
        return forecast_fields(self.cells, floor, frames, grid.frame_shape, grid.patch_shape, self.pitches_m)

    def fields_factor(self) -> float | None:
        """Return by which factor exposures must change for the fields to be retrieved; None if no exposure suffices."""

        def excess(longer: Prediction) -> float:
            forecast = longer.forecast_fields(1)
            return 0.0 if forecast is None else forecast.photons_per_grain / forecast.needed_photons_per_grain

        return self._least_factor(excess)

    def third_moment_signal_to_noise(self, frames: int) -> float | None:
        """Return the third moment of filtered frames over its standard error, which limits how well `invert`
        distinguishes speckle from texture; None if signal is less than a fifth of the estimate at every lag."""
        floor = self.terms.floor_over_peak()
        if floor is None:
            return None
        weight = self.signal / (self.signal + floor)
        weight[(weight < MIN_SIGNAL_FRACTION) | (lag_grid_of(weight).ring < 2)] = 0.0
        if not weight.any() or not self.cells.any():
            return None
        terms = self.terms
        pixels = math.prod(self.grid.patch_shape)
        mean, deviation = drawn_third_moment(
            self.cells,
            weight,
            self.transfer,
            pixels,
            terms.signal**2 * terms.grain_pixels,
            terms.ambient + terms.dark,
            terms.read,
            polarisations=self.polarisations,
        )
        patches = frames * math.prod(self.grid.frame_shape) / pixels
        return max(0.0, mean) / deviation * patches**0.5

    def signal_to_noise(self, frames: int) -> float | None:
        """Return the signal-to-noise ratio, averaged over the lags of the object with the signal as weight; None without light."""
        floor = self.terms.floor_over_peak()
        if floor is None:
            return None
        weight = self.signal / self.signal.sum()
        return float((weight * self.signal / (self.signal + floor)).sum()) * math.sqrt(self.dof(frames))


def noise_terms(geometry: Any, albedo: np.ndarray, cell_area_m2: float, square_sum: float | None = None) -> NoiseTerms:
    """Return the noise terms of one frame of a scene.

    Args:
        albedo: albedo of the object, weighted by its illumination, on cells of `cell_area_m2` across the line of sight.
        square_sum: see `grain_area`.
    """
    electronics = geometry.electronics
    grain = grain_area(albedo, cell_area_m2, geometry.wavelength_m, geometry.distance_m, square_sum)
    ambient = geometry.ambient_photoelectrons_per_pixel_s
    # Subjective grain of the virtual detector behind a circular pupil: (lambda z)^2 / A (Goodman, Speckle Phenomena, Eq. 4-75).
    pupil_area = 0.25 * math.pi * geometry.pupil_diameter_m**2
    subjective_grain = (geometry.wavelength_m * geometry.pupil_distance_m) ** 2 / pupil_area
    signal = light_budget(geometry.light_path).photoelectrons_per_pixel_s * electronics.exposure_s
    # Fraction of the speckle variance that remains with two incoherent polarisations and with motion.
    kept = (0.5 if geometry.is_depolarised else 1.0) * float(geometry.motion.transfer(np.zeros(1), np.zeros(1))[0])
    other = (
        geometry.other_light_share * signal if geometry.other_light_share > 1e-3 else 0.0
    )  # a smaller fraction is not modelled
    return NoiseTerms(
        signal=signal,
        grain_pixels=grain / geometry.seen_pixel_area_m2 * kept,
        ambient=other + (0.0 if ambient is None else float(ambient.mean()) * electronics.exposure_s),
        dark=electronics.dark_current * electronics.exposure_s,
        read=electronics.read_noise**2,
        quantisation=electronics.step**2 / 12.0,
        # The mean square falls from 2 to 1 + kept; the subjective speckle of the virtual detector keeps the same fraction of its variance.
        detector_grain_pixels=subjective_grain / geometry.pixel_pitch_m**2 * 0.5 * (1.0 + kept) * kept,
        gates=electronics.gates,
        modes=1.0 / kept,
    )


def patches_of(geometry: Any, patch: int | None = None, lags: int = LAGS) -> tuple[PatchGrid, tuple[float, float]]:
    """Return the division of a scene's frames into patches of `patch` pixels (None: as in `invert`), and the lag pitches in metres.

    The pitches are (rows, columns).
    """
    facts = (geometry.wavelength_m, geometry.distance_m, geometry.seen_pitch_m)
    grid = patch_grid(geometry.frame_shape, patch or automatic_patch_size(geometry.frame_shape, facts, lags=lags), lags)
    return grid, grid.lag_pitches_m(*facts)


def predict(geometry: Any, patch: int | None = None, lags: int = LAGS) -> Prediction:
    """Predict the estimate of a scene's frames with patches of `patch` pixels (None: as in `invert`) and a number of lags."""
    grid, pitches_m = patches_of(geometry, patch, lags)
    hidden = geometry.hidden_object
    cell = (pitches_m[0] / CELLS_PER_LAG, pitches_m[1] / CELLS_PER_LAG)
    shown = grid.lag_grid.object_side
    side = max(
        shown * CELLS_PER_LAG, *(math.ceil(extent / step) + 1 for extent, step in zip(hidden.extent_m, cell, strict=True))
    )
    albedo = hidden.sample(cell, (side, side)).albedo
    correlation = autocorrelate(albedo)
    transfer = lag_transfer(
        grid.lag_grid.steps,
        grid.patch_shape,
        geometry.pixel_pitch_m,
        geometry.pupil_diameter_m,
        geometry.wavelength_m,
        geometry.pupil_distance_m,
    )
    steps = grid.lag_grid.steps.astype(float)
    if geometry.motion.moves:
        left = geometry.motion.transfer(steps[:, None] * pitches_m[0], steps[None, :] * pitches_m[1])
        transfer = transfer * left / left[lags, lags]
    peak = peak_of_cell_means(correlation)
    signal = smooth_by_window(correlation / peak if peak > 0.0 else correlation, CELLS_PER_LAG, lags) * transfer
    terms = noise_terms(geometry, albedo, cell[0] * cell[1] * hidden.axes.cell, peak)
    half = shown * CELLS_PER_LAG // 2
    middle = [slice(size // 2 - half, size // 2 - half + shown * CELLS_PER_LAG) for size in albedo.shape]
    cells = albedo[tuple(middle)].reshape(shown, CELLS_PER_LAG, shown, CELLS_PER_LAG).mean((1, 3))
    if cells.sum() * CELLS_PER_LAG**2 < 0.99 * albedo.sum():  # the object is wider than the lags
        cells = np.zeros_like(cells)
    return Prediction(terms, grid, pitches_m, signal, transfer, cells, 2 if geometry.is_depolarised else 1)
