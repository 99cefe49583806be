"""Rendered frames show the floor, the degrees of freedom and the distribution that the noise model predicts."""

import numpy as np
import pytest
from scipy import stats

pytest.importorskip("mitsuba")

from correlograph.lags import LAGS, lag_grid
from radiometry.autocorrelation import PatchGrid, autocorrelate
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
from radiometry.noise.measured_noise import fit_known_signal, read_noise_level
from radiometry.photons import grain_area
from radiometry.prediction import predict

COLUMN_LAG = lag_grid(LAGS).column
HALF_PLANE = lag_grid(LAGS).half_plane
RING = lag_grid(LAGS).ring
ROW_LAG = lag_grid(LAGS).row

APART = (ROW_LAG % 3 == 0) & (COLUMN_LAG % 3 == 0)
"""Lags that hardly correlate."""

SIGNAL_FREE = HALF_PLANE & (RING > 40) & APART
"""Lags beyond 12 mm: the letters end at 10 mm."""


@pytest.mark.parametrize("exposure", ["0.001953125", "0.015625", "0.125", "1"])
@pytest.mark.parametrize("letter", ["F", "7", "R", "t"])
def test_floor_dof_and_distribution_of_rendered_frames(letter_simulation, letter, exposure):
    simulation = letter_simulation(letter, exposure=exposure)
    prediction = predict(simulation.geometry)
    frames = [simulation.frame(11, number).numpy() for number in range(2)]
    estimate, dof = estimate_autocorrelation(frames, prediction.grid)
    assert dof == prediction.dof(2) == pytest.approx(325, rel=0.01)
    # At a 512th of a second a single capture tells its floor to a tenth.
    captures = [estimate]
    if float(exposure) < 0.01:
        pairs = [[simulation.frame(seed, number).numpy() for number in range(2)] for seed in (12, 13, 14)]
        captures += [estimate_autocorrelation(pair, prediction.grid)[0] for pair in pairs]
    gain, floor = np.mean([fit_known_signal(one, prediction.signal) for one in captures], axis=0)
    assert floor / gain == pytest.approx(prediction.shot_floor_over_peak, rel=0.10)
    assert read_noise_level(estimate).dof == pytest.approx(dof, rel=0.10)
    free = estimate[SIGNAL_FREE]
    assert stats.kstest(free / free.mean(), stats.gamma(dof, scale=1.0 / dof).cdf).pvalue > 0.01


def test_the_autocorrelation_of_rendered_frames_is_h_times_that_of_the_albedo(letter_simulation):
    """Lag by lag, noise-free: nothing is fitted but one gain; the same without H, or mirrored, is far off."""
    simulation = letter_simulation("7", exposure="1")
    prediction = predict(simulation.geometry)
    frames = [simulation.expected_frame(5, number).numpy() for number in range(9)]
    estimate, dof = estimate_autocorrelation(frames, prediction.grid)

    def excess(signal: np.ndarray) -> float:
        """Variance about the expected shape over that of Gamma noise of K = dof, at the lags with signal."""
        shown = HALF_PLANE & (RING > 2) & (signal > 0.02 * signal.max())
        ratio = estimate[shown] / signal[shown]
        return float((ratio / ratio.mean()).var() * dof)

    # A little above 1: all patches see one draw of the object's own speckle, which their K leaves out.
    assert 0.7 < excess(prediction.signal) < 2.2
    assert excess(prediction.signal / prediction.transfer) > 4.0
    assert excess(prediction.signal[:, ::-1]) > 100.0


def test_the_prediction_is_one_over_photons_per_coherence_area(letter_simulation):
    simulation = letter_simulation("7")
    geometry = simulation.geometry
    cell = 1e-2 / 256
    albedo = geometry.hidden_object.sample((cell, cell), (256, 256)).albedo
    grain = grain_area(albedo, cell**2, geometry.wavelength_m, geometry.distance_m)
    assert grain == pytest.approx(1.4e-8, rel=0.05)
    per_area = simulation.mean_photoelectrons / geometry.seen_pixel_area_m2
    prediction = predict(geometry)
    assert prediction.shot_floor_over_peak == pytest.approx(1.0 / (per_area * grain), rel=0.02)
    assert autocorrelate(albedo).max() == pytest.approx(albedo.sum(), rel=0.02)  # but for cells on an edge


@pytest.mark.parametrize("patches", [1, 2, 3])
def test_few_degrees_of_freedom_are_gamma_and_not_gaussian(letter_simulation, patches):
    simulation = letter_simulation("F", exposure="0.015625")
    grid = PatchGrid(257, 1, patches, (257, 257 * patches))
    frames = [simulation.frame(2, number).numpy()[:257, : 257 * patches] for number in range(2)]
    estimate, dof = estimate_autocorrelation(frames, grid, "published")
    free = estimate[HALF_PLANE & (RING > 40)] / simulation.mean_photoelectrons
    assert dof == patches
    assert stats.kstest(free / free.mean(), stats.gamma(dof, scale=1.0 / dof).cdf).pvalue > 0.01
    assert stats.kstest(free / free.mean(), stats.norm(1.0, dof**-0.5).cdf).pvalue < 1e-6


def test_read_noise_dark_current_and_quantisation_raise_the_floor_as_predicted(letter_simulation):

    from sim.frame import Simulation

    base = letter_simulation("L", exposure="0.125").geometry
    geometry = base.with_electronics(read_noise=0.4, dark_current=0.5, full_well=60.0, bits=6)
    prediction = predict(geometry)
    simulation = Simulation(geometry)
    estimate, _ = estimate_autocorrelation([simulation.frame(1, number).numpy() for number in range(2)], prediction.grid)
    gain, floor = fit_known_signal(estimate, prediction.signal)
    terms = prediction.terms
    expected = terms.floor_over_peak() - terms.over_peak()["detector_speckle"]  # not modelled by the renderer
    assert expected > 3.0 * prediction.shot_floor_over_peak
    assert floor / gain == pytest.approx(expected, rel=0.10)
