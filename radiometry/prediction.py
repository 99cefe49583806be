"""Prediction for a scene: noise terms, floor over peak, degrees of freedom, known r*r.

The functions accept a `sim.geometry.Geometry`, but this module does not import the simulator.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import brentq

from correlograph.lags import LAGS, lag_grid_of
from radiometry.autocorrelation import (
    PatchGrid,
    automatic_patch_size,
    patch_grid,
    peak_of_cell_means,
    smooth_by_window,
)
from radiometry.coherence import autocorrelate_coherent
from radiometry.estimation.autocorrelation_estimator import degrees_of_freedom
from radiometry.estimation.fixed_pattern import shared_lags
from radiometry.estimation.third_moment import MIN_SIGNAL_FRACTION, PatchLight, drawn_third_moment
from radiometry.field_forecast import FieldForecast, cells_of, forecast_fields
from radiometry.light_budget_rows import light_budget
from radiometry.noise.detection import DETECTION_LIMIT, detection
from radiometry.noise.measured_noise import WHOLE_FRAME_INFLATION, NoiseLevel
from radiometry.noise.predicted_floor import NoiseTerms, estimate_error
from radiometry.photons import grain_area
from radiometry.ring_correlation import SpeckledImage
from radiometry.sensor import chain
from radiometry.sensor.electronics import MAX_GATES
from radiometry.sensor.stage import SpeckleLight
from radiometry.transfer import lag_transfer, subjective_modes

CELLS_PER_LAG = 4
"""Cells per lag of the albedo from which the known r*r is computed."""

EXPOSURES_S = (1e-12, 1e12)
"""Shortest and longest exposure that the search for an exposure considers."""

EXPOSURE_OCTAVES = 1e-3
"""Accuracy of the exposure that the search finds, in octaves."""

SEARCH_STEP = 2.0
"""Step of that search in octaves."""


@dataclass(frozen=True)
class Prediction:
    """Expected estimate of a scene, for patches of `grid`.

    Attributes:
        geometry: the scene. Everything that depends on its exposure is derived from it.
        pitches_m: object distance of one lag along rows and columns.
        correlation: r*r, smoothed by the window, (127, 127), in units of (r*r)(0).
        camera_transfer: H of pupil and pixel at each lag, (127, 127).
        cells: the albedo (64, 64), one cell per lag; zero for a wider object.
        grain_m2: coherence area of the speckle on the wall.
        speckled: mean |E|^2 of the fields of frames, for their resolution.
    """

    geometry: Any
    grid: PatchGrid
    pitches_m: tuple[float, float]
    correlation: np.ndarray
    camera_transfer: np.ndarray
    cells: np.ndarray
    grain_m2: float
    speckled: SpeckledImage

    def at_exposure(self, exposure_s: float) -> Prediction:
        """Return the prediction for another exposure."""
        return replace(self, geometry=self.geometry.with_exposure(exposure_s))

    @property
    def pitch_m(self) -> float:
        """Object distance of one lag along the row axis."""
        return self.pitches_m[0]

    @property
    def polarisations(self) -> int:
        """Number of incoherent patterns that share the light."""
        return 2 if self.geometry.is_depolarised else 1

    @cached_property
    def terms(self) -> NoiseTerms:
        """Light and sensor, from which the noise follows."""
        return NoiseTerms(speckle_light(self.geometry, self.grain_m2), self.geometry.camera.electronics)

    @cached_property
    def transfer(self) -> np.ndarray:
        """H per lag (127, 127), times the factor M of motion at each lag in units of that at zero lag."""
        motion, lags = self.geometry.motion, self.grid.lag_grid.lags
        if not motion.moves:
            return self.camera_transfer
        steps = self.grid.lag_grid.steps.astype(float)
        left = motion.transfer(steps[:, None] * self.pitches_m[0], steps[None, :] * self.pitches_m[1])
        return self.camera_transfer * left / left[lags, lags]

    @cached_property
    def signal(self) -> np.ndarray:
        """H (r*r), smoothed by the window, (127, 127), in units of (r*r)(0)."""
        return self.correlation * self.transfer

    @property
    def shot_floor_over_peak(self) -> float | None:
        """One over the photoelectrons per coherence area; None without light."""
        return self.terms.over_peak()["signal"]

    def floor_over_peak(self, frames: int) -> float | None:
        """Return the floor of an estimate, without the static pattern if `invert` subtracts it; None without light."""
        floor = self.terms.floor_over_peak()
        if floor is None or not self.subtracts_pattern(frames):
            return floor
        return floor - self.terms.static_over_peak()

    def dof(self, frames: int) -> float:
        """Return K of an estimate. Subtraction of a static pattern costs the degrees of freedom of one frame."""
        counted = frames - 1 if self.subtracts_pattern(frames) else frames
        return degrees_of_freedom(counted, self.grid.frame_shape, self.grid.patch_shape)

    def subtracts_pattern(self, frames: int) -> bool:
        """Return whether `invert` subtracts the static pattern of the sensor from an estimate: whether the power that the frames are
        expected to share is significant.
        """
        static, floor = self.terms.static_over_peak(), self.terms.floor_over_peak()
        if static == 0.0 or floor is None or frames < 2:
            return False
        power = self.signal + floor
        shared_dof = degrees_of_freedom(frames * (frames - 1), self.grid.frame_shape, self.grid.patch_shape)
        return bool(shared_lags(np.full_like(power, static), power, shared_dof).mean() > 0.5)

    def line_noise_over_peak(self) -> dict[str, float]:
        """Return what the noise of rows or columns adds to the lags of one axis: its variance times the side of a patch."""
        side = {"row": self.grid.patch_shape[1], "column": self.grid.patch_shape[0]}
        stages = [stage for stage in chain.stages_of(self.geometry.camera.electronics) if stage.spread in side]
        return {stage.name: side[stage.spread] * self.terms.share(stage) for stage in stages}

    def detection(self, frames: int) -> float:
        """Return the expected significance of the signal in standard deviations, as `invert` computes it from an estimate."""
        floor = self.floor_over_peak(frames)
        if floor is None:
            return 0.0
        noise = NoiseLevel(floor, self.dof(frames), self.grid.lag_grid.lags, WHOLE_FRAME_INFLATION)
        return detection(self.signal + floor, noise)

    def detection_exposure_s(self, frames: int) -> float | None:
        """Return the shortest exposure of each frame at which the object is detected; None if no exposure suffices."""
        return self._shortest_exposure_s(lambda other: other.detection(frames) / DETECTION_LIMIT)

    def error(self, frames: int) -> float | None:
        """Return the relative error of the estimate's signal, root mean square over all lags; None without light."""
        floor, signal = self.floor_over_peak(frames), self.signal
        if floor is None:
            return None
        square = float((signal**2).sum())
        noise = estimate_error(float(signal.sum()), square, signal.size, floor, self.dof(frames))
        lines = math.fsum(2.0 * self.grid.lag_grid.lags * share**2 for share in self.line_noise_over_peak().values())
        return math.hypot(noise, math.sqrt(lines / square))

    def error_exposure_s(self, frames: int, error: float) -> float | None:
        """Return the shortest exposure of each frame with an error of the estimate; None if no exposure suffices."""
        return self._shortest_exposure_s(lambda other: error / (other.error(frames) or math.inf))

    def forecast_light(self, frames: int) -> FieldForecast | None:
        """Return the forecast of `--method field` without the resolution, which costs a sampling of the object; None without light, and
        for an object wider than the lags.
        """
        floor, grid = self.terms.floor_over_peak(), self.grid
        return forecast_fields(self.cells, floor, frames, grid.frame_shape, grid.patch_shape, self.pitches_m)

    def forecast_fields(self, frames: int) -> FieldForecast | None:
        """Return the forecast of `--method field`; None like `forecast_light`."""
        found = self.forecast_light(frames)
        return None if found is None else replace(found, resolution_m=self.speckled.half_period_m(found.looks))

    def fields_exposure_s(self) -> float | None:
        """Return the shortest exposure at which the field of a frame can be retrieved; None if no exposure suffices."""

        def excess(other: Prediction) -> float:
            forecast = other.forecast_light(1)
            return 0.0 if forecast is None else forecast.photons_per_grain / forecast.needed_photons_per_grain

        return self._shortest_exposure_s(excess)

    def _shortest_exposure_s(self, excess: Callable[[Prediction], float]) -> float | None:
        """Return the shortest exposure at which `excess` is 1 or more.

        It grows with the exposure if nothing moves. Motion blurs long exposures, so that it falls again; the search then climbs in
        steps of `SEARCH_STEP`.
        """

        def log_excess(octaves: float) -> float:
            return math.log(max(excess(self.at_exposure(2.0**octaves)), 1e-300))

        lowest, highest = (math.log2(limit) for limit in EXPOSURES_S)
        gate = self.geometry.camera.electronics.gate
        if gate:
            lowest, highest = (
                max(lowest, math.log2(gate) + EXPOSURE_OCTAVES),
                min(highest, math.log2(MAX_GATES * gate) - 2.0 * EXPOSURE_OCTAVES),
            )
        if log_excess(lowest) >= 0.0:
            return 2.0**lowest
        step = SEARCH_STEP if self.geometry.motion.moves else highest - lowest
        for start in np.arange(lowest, highest, step):
            octaves = min(start + step, highest)
            if log_excess(octaves) >= 0.0:
                return 2.0 ** (float(brentq(log_excess, start, octaves, xtol=EXPOSURE_OCTAVES)) + EXPOSURE_OCTAVES)
        return None

    def third_moment_signal_to_noise(self, frames: int) -> float | None:
        """Return the third moment of filtered frames over its standard error, which limits how well `invert`
        distinguishes speckle from texture; None if signal is less than a fifth of the estimate at every lag."""
        floor = self.floor_over_peak(frames)
        if floor is None:
            return None
        weight = self.signal / (self.signal + floor)
        weight[(weight < MIN_SIGNAL_FRACTION) | (lag_grid_of(weight).ring < 2)] = 0.0
        if not weight.any() or not self.cells.any():
            return None
        light, electronics = self.terms.light, self.terms.electronics
        pixels = math.prod(self.grid.patch_shape)
        mean, deviation = drawn_third_moment(
            self.cells,
            weight,
            self.transfer,
            pixels,
            PatchLight(
                light.signal**2 * light.grain_pixels,
                self.terms.mean - light.signal,
                electronics.read_noise**2,
                self.polarisations,
            ),
        )
        patches = frames * math.prod(self.grid.frame_shape) / pixels
        return max(0.0, mean) / deviation * patches**0.5

    def signal_to_noise(self, frames: int) -> float | None:
        """Return the signal-to-noise ratio, averaged over the lags of the object with the signal as weight; None without light."""
        floor = self.floor_over_peak(frames)
        if floor is None:
            return None
        weight = self.signal / self.signal.sum()
        return float((weight * self.signal / (self.signal + floor)).sum()) * math.sqrt(self.dof(frames))


def speckle_light(geometry: Any, grain_m2: float) -> SpeckleLight:
    """Return the light of one frame of a scene, whose speckle has a coherence area on the wall."""
    exposure_s = geometry.camera.electronics.exposure_s
    ambient = geometry.ambient_photoelectrons_per_pixel_s
    optics = (
        geometry.camera.pixel_pitch_m,
        geometry.camera.pupil_diameter_m,
        geometry.wavelength_m,
        geometry.camera.pupil_distance_m,
    )
    signal = light_budget(geometry.light_path).photoelectrons_per_pixel_s * exposure_s
    # Fraction of the speckle variance that remains with two incoherent polarisations and with motion.
    polarised = 0.5 if geometry.is_depolarised else 1.0
    kept = polarised * float(geometry.motion.transfer(np.zeros(1), np.zeros(1))[0])
    return SpeckleLight(
        signal=signal,
        grain_pixels=grain_m2 / geometry.seen_pixel_area_m2 * kept,
        ambient=0.0 if ambient is None else float(ambient.mean()) * exposure_s,
        stray=geometry.other_light_share * signal,
        # The mean square falls from 2 to 1 + kept. Neither motion nor a second polarisation averages the subjective speckle: the field is
        # nearly uniform over the point spread function, so that the heights of the wall multiply all light by one factor.
        detector_speckle=0.5 * (1.0 + kept) / subjective_modes(*optics),
        modes=1.0 / kept,
    )


def _paths(geometry: Any, cell_m: tuple[float, float], depth_m: np.ndarray) -> np.ndarray:
    """Return the length of the light path by every cell of a grid (n, n), in metres."""
    hidden, side = geometry.hidden_object, len(depth_m)
    rows, columns = ((np.arange(side) - 0.5 * (side - 1)) * step for step in cell_m)
    grid = np.stack(np.meshgrid(rows, columns, indexing="ij"), -1).reshape(-1, 2)
    place = hidden.centre + hidden.position(grid, depth_m.ravel())
    path = sum(np.linalg.norm(place - end, axis=1) for end in (geometry.spot.centre, geometry.camera.centre))
    return np.reshape(path, depth_m.shape)


def patches_of(geometry: Any, patch: int | None = None, lags: int = LAGS) -> tuple[PatchGrid, tuple[float, float]]:
    """Return the division of a scene's frames into patches of `patch` pixels (None: as in `invert`), and the lag pitches in metres.

    The pitches are (rows, columns).
    """
    facts = (geometry.wavelength_m, geometry.distance_m, geometry.seen_pitch_m)
    grid = patch_grid(
        geometry.camera.frame_shape, patch or automatic_patch_size(geometry.camera.frame_shape, facts, lags=lags), lags
    )
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
    seen = hidden.sample(cell, (side, side))
    albedo = seen.albedo
    correlation = autocorrelate_coherent(albedo, _paths(geometry, cell, seen.depth_m), geometry.spot.linewidth_hz)
    transfer = lag_transfer(
        grid.lag_grid.steps,
        grid.patch_shape,
        geometry.camera.pixel_pitch_m,
        geometry.camera.pupil_diameter_m,
        geometry.wavelength_m,
        geometry.camera.pupil_distance_m,
    )
    peak = peak_of_cell_means(correlation)
    smooth = smooth_by_window(correlation / peak if peak > 0.0 else correlation, CELLS_PER_LAG, lags)
    grain = grain_area(albedo, cell[0] * cell[1] * hidden.axes.cell, geometry.wavelength_m, geometry.distance_m, peak)
    half = shown * CELLS_PER_LAG // 2
    middle = [slice(size // 2 - half, size // 2 - half + shown * CELLS_PER_LAG) for size in albedo.shape]
    cells = albedo[tuple(middle)].reshape(shown, CELLS_PER_LAG, shown, CELLS_PER_LAG).mean((1, 3))
    if cells.sum() * CELLS_PER_LAG**2 < 0.99 * albedo.sum():  # the object is wider than the lags
        cells = np.zeros_like(cells)
    speckled = SpeckledImage(hidden, cells_of(pitches_m, grid.frame_shape, grid.patch_shape), geometry.motion.grain_m)
    return Prediction(geometry, grid, pitches_m, smooth, transfer, cells, grain, speckled)
