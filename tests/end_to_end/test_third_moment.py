"""Third moment of frames: predicted for a scene, drawn, and seen in rendered frames."""

import math

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from correlograph.lags import LAGS, lag_grid
from radiometry.autocorrelation import autocorrelate, smooth_by_window
from radiometry.estimation import third_moment
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator
from radiometry.estimation.third_moment import PatchLight, drawn_third_moment, expected_third_moment
from radiometry.prediction import predict
from scenes import scene_path
from sim.frame import Simulation
from sim.scene_file import load_scene
from sim.scene_reader import read_geometry
from tests.invert.posterior.steps import RIGHT

RING = lag_grid(LAGS).ring


@pytest.mark.parametrize("polarisations", [1, 2])
@pytest.mark.parametrize("peak", [3e3, 30.0])
def test_drawn_patches_have_the_third_moment_in_closed_form(polarisations, peak):
    """2 tr((D M)^3) for one polarisation; two share the light and leave 2^-1/2 of it. Shot noise adds nothing."""
    albedo = RIGHT.numpy().astype(np.float64)
    rows, columns = np.mgrid[-63:64, -63:64]
    weight = np.where(RING < 2, 0.0, np.exp(-(rows**2 + 2.0 * columns**2) / 400.0))
    transfer = np.exp(-np.hypot(rows, columns) / 40.0)
    light = PatchLight(peak, 0.1, 0.2, polarisations)
    mean, deviation = drawn_third_moment(albedo, weight, transfer, 128**2, light, draws=1000)
    expected = expected_third_moment(albedo / np.sqrt(np.square(albedo).sum()), weight * np.sqrt(transfer), peak, 128**2)
    assert mean == pytest.approx(expected / math.sqrt(polarisations), rel=0.05, abs=3.0 * deviation / 1000**0.5)


@pytest.mark.slow
def test_its_signal_to_noise_is_that_of_rendered_frames():
    """One frame of 1/100 s of the reference scene, sixteen times, over the moment of the true object's speckle."""
    geometry = read_geometry(load_scene(scene_path("corner_letter"), {"exposure": "0.01"})[0])
    prediction, simulation = predict(geometry), Simulation(geometry)
    floor = prediction.terms.floor_over_peak()
    share = prediction.signal / (prediction.signal + floor)
    weight = np.where((share < 0.2) | (RING < 2), 0.0, share)
    peak = prediction.terms.light.signal**2 * prediction.terms.light.grain_pixels
    truth = geometry.hidden_object.cell_means(prediction.pitches_m, 64)
    known = smooth_by_window(autocorrelate(truth)) * prediction.transfer
    seen = []
    for seed in range(16):
        estimator = AutocorrelationEstimator(prediction.grid)
        estimator.add(simulation.frame(seed, 0))
        signal = estimator.estimate() - peak * floor
        power = float((weight**2 * signal).sum() / (weight**2 * known).sum())
        frames = estimator.filtered_frames()
        seen.append(frames.likeness(truth, weight, np.sqrt(prediction.transfer), signal, peak * floor, power)[0])
    deviation = np.std(seen, ddof=1)
    assert np.mean(seen) == pytest.approx(1.0, abs=3.0 * deviation / 4.0)
    # The deviation of sixteen is good to 18 %.
    assert 1.0 / deviation == pytest.approx(prediction.third_moment_signal_to_noise(1), rel=0.5)


@pytest.mark.parametrize("reach", [0.1, 0.4])
def test_estimated_trace_is_that_of_the_matrix(monkeypatch, reach):
    rng = np.random.default_rng(4)
    rows, columns = np.indices((96, 96))
    albedo = rng.random((96, 96)) * (rows + 2 * columns < 160) * (columns > 9)  # 3500 cells, no symmetry
    distance = np.hypot(*np.meshgrid(np.arange(-95, 96), np.arange(-95, 96)))
    weight = np.exp(-distance / (95 * reach))
    estimated = third_moment.expected_third_moment(albedo, weight, 1.0, 1)
    monkeypatch.setattr(third_moment, "MAX_EXACT_CELLS", 10**6)
    assert estimated == pytest.approx(third_moment.expected_third_moment(albedo, weight, 1.0, 1), rel=0.03)
