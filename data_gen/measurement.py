"""Measurements of targets: an autocorrelation estimate from the noise model, or from rendered frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from correlograph.errors import InputError
from correlograph.lags import LAGS
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
from radiometry.noise.model import autocorrelate_windowed, draw_estimate, expected_spectrum
from radiometry.photons import grain_area
from radiometry.prediction import predict


def model_measurement(
    albedo: torch.Tensor, floor_over_peak: torch.Tensor, dof: torch.Tensor, rng: torch.Generator
) -> torch.Tensor:
    """Sample noisy estimates, in units of (r*r)(0), from the noise model.

    Args:
        albedo: (n, 64, 64), none of them zero everywhere.
        floor_over_peak, dof: (n,).

    Returns:
        (n, 127, 127), zero lag at [63, 63].
    """
    signal = autocorrelate_windowed(albedo) / albedo.square().sum((-2, -1))[..., None, None]
    return draw_estimate(expected_spectrum(signal, floor_over_peak), dof, rng)


def draw_noise_levels(
    count: int, floor_over_peak: tuple[float, float], dof: tuple[float, float], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Sample floors over peak and degrees of freedom, log-uniform in their ranges, each float32 (count,)."""

    def log_uniform(low: float, high: float) -> np.ndarray:
        return np.exp(rng.uniform(np.log(low), np.log(high), count)).astype(np.float32)

    return log_uniform(*floor_over_peak), log_uniform(*dof)


class SceneMeasurement:
    """Measurements of targets that replace the hidden object of a scene, rendered or from the noise model.

    Args:
        scene_path: scene whose hidden object the targets replace, one cell per lag.
        lags: largest lag of the estimates.
        frames: frames per measurement.
    """

    def __init__(self, scene_path: str, lags: int = LAGS, frames: int = 2) -> None:
        from sim.frame import Simulation
        from sim.scene_file import load_scene
        from sim.scene_reader import read_geometry

        scene, _ = load_scene(scene_path)
        self._simulation = Simulation(read_geometry(scene))
        self._prediction = prediction = predict(self._simulation.geometry, lags=lags)
        self._grid, self._pitches_m, self._frames = prediction.grid, prediction.pitches_m, frames
        self._transfer = torch.from_numpy(prediction.transfer.astype(np.float32))
        self.dof = prediction.dof(frames)
        if prediction.shot_floor_over_peak is None:
            raise InputError("--scene", "light from the hidden object", f"none in {scene_path}", "choose another scene")

    def noise_level(self, albedo: np.ndarray) -> tuple[float, float]:
        """Return the floor and (r*r)(0) of the estimate of an albedo (64, 64), in electrons squared."""
        geometry = self._simulation.geometry.with_object(albedo, self._pitches_m)
        cell_m2 = self._pitches_m[0] * self._pitches_m[1] * geometry.hidden_object.axes.cell
        grain_m2 = grain_area(albedo, cell_m2, geometry.wavelength_m, geometry.distance_m)
        prediction = replace(self._prediction, geometry=geometry, grain_m2=grain_m2)
        floor, light = prediction.floor_over_peak(self._frames) or 0.0, prediction.terms.light
        if not self._simulation.effects["detector_roughness"].modelled:
            floor -= prediction.terms.over_peak()["detector_speckle"] or 0.0
        peak = light.signal**2 * light.grain_pixels
        return floor * peak, peak

    def render(self, albedo: np.ndarray, seed: int) -> np.ndarray:
        """Return the estimate (127, 127) from rendered frames, in units of (r*r)(0)."""
        shown = self._simulation.with_object(albedo, self._pitches_m)
        frames = (shown.frame(seed, number) for number in range(self._frames))
        return estimate_autocorrelation(frames, self._grid)[0] / self.noise_level(albedo)[1]

    def model(self, albedo: torch.Tensor, floor_over_peak: torch.Tensor, rng: torch.Generator) -> torch.Tensor:
        """Sample estimates (n, 127, 127) from the noise model with the camera's H, in units of (r*r)(0)."""
        signal = autocorrelate_windowed(albedo) / albedo.square().sum((-2, -1))[..., None, None]
        return draw_estimate(expected_spectrum(signal, floor_over_peak, self._transfer), self.dof, rng, correlated=True)
