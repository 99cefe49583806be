"""Shot noise alone: the floor and the degrees of freedom that rendered frames show are the predicted ones."""

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from radiometry.autocorrelation import LAGS, autocorrelate, estimate_autocorrelation, patch_grid, window_smooth
from radiometry.noise_model import fit_known_signal, read_noise_level
from radiometry.photons import grain_area, ideal_floor_over_peak
from radiometry.transfer import lag_transfer

CELLS_PER_LAG = 4


@pytest.mark.parametrize("exposure", ["0.001953125", "0.015625", "0.125", "1"])
@pytest.mark.parametrize("letter", ["F", "7", "R"])
def test_floor_and_dof_of_rendered_frames(letter_simulation, letter, exposure):
    simulation = letter_simulation(letter, exposure=exposure)
    geometry = simulation.geometry
    facts = (geometry.wavelength_m, geometry.distance_m, geometry.pixel_pitch_m)
    grid = patch_grid(geometry.frame_shape, 257)
    pitch = grid.lag_pitch_m(*facts)
    cell = pitch / CELLS_PER_LAG
    albedo = geometry.hidden_object.sample((cell, cell), (64 * CELLS_PER_LAG, 64 * CELLS_PER_LAG)).albedo

    estimate, dof = estimate_autocorrelation([simulation.frame(11, number).numpy() for number in range(2)], grid)
    lags = autocorrelate(albedo)
    transfer = lag_transfer(np.arange(-LAGS, LAGS + 1), pitch, geometry.distance_m, geometry.pixel_pitch_m,
                            geometry.pupil_diameter_m, geometry.wavelength_m, geometry.pupil_distance_m)
    gain, floor = fit_known_signal(estimate, window_smooth(lags, CELLS_PER_LAG) * transfer)

    grain = grain_area(albedo, cell**2, geometry.wavelength_m, geometry.distance_m)
    expected = ideal_floor_over_peak(simulation.mean_photoelectrons / geometry.pixel_pitch_m**2, grain)
    assert dof == 64
    assert floor / (gain * lags.max()) == pytest.approx(expected, rel=0.15)
    assert read_noise_level(estimate).dof == pytest.approx(dof, rel=0.10)
