"""Noisy root finding, and the exposure at which reconstructions of rendered frames reach a correlation."""

import numpy as np
import pytest

from correlograph.commands.required_error import STANDARD_ERROR, RequiredError, solve
from correlograph.errors import InputError

pytest.importorskip("mitsuba")


@pytest.mark.parametrize(("true", "start"), [(3.0, 0.01), (0.2, 40.0)])
def test_noisy_functions_are_solved_within_the_stated_error(true, start):
    """A mean of 0.9 at `true` with a slope of 0.125 per unit of the logarithm, and a deviation of 0.04."""

    def sample(place, seed):
        return (
            float(np.clip(0.9 + 0.125 * np.log(place / true), 0.0, 0.97)) + 0.04 * np.random.default_rng(seed).standard_normal()
        )

    errors = [np.log(solve(sample, 0.9, start, 1000 * trial) / true) for trial in range(40)]
    assert np.sqrt(np.mean(np.square(errors))) < 1.5 * STANDARD_ERROR
    assert abs(np.mean(errors)) < 0.5 * STANDARD_ERROR


def test_a_level_out_of_reach_is_refused():
    with pytest.raises(InputError, match="can reach"):
        solve(lambda place, seed: 0.5, 0.9, 1.0)


@pytest.mark.slow
def test_the_error_is_that_of_an_exposure_whose_reconstructions_have_the_correlation():
    import correlograph as cg
    from radiometry.prediction import predict
    from sim.rendering import render_geometry
    from sim.scene import load

    geometry = load("corner_letter").geometry
    geometry = geometry.with_camera(pixel_pitch_m=2.0 * geometry.camera.pixel_pitch_m, frame_shape=(700, 560))
    prediction = predict(geometry)
    required = RequiredError(0.85, 2, "fast")
    error = required(geometry, prediction)
    exposure_s = prediction.error_exposure_s(2, error)
    truth = cg.Truth(prediction.cells, prediction.pitches_m)
    seen = geometry.with_exposure(exposure_s)
    scores = []
    for seed in range(500, 516):
        result = cg.reconstruct(render_geometry(seen, 2, seed), quality="fast", seed=seed)
        scores.append(cg.aligned_pearson(result.albedo, result.truth_on_lags(truth))[0])
    assert np.mean(scores) == pytest.approx(0.85, abs=0.035)
    # A camera with equal lags shares the result; one with others does not.
    same = geometry.with_camera(frame_shape=(800, 900)).with_electronics(read_noise=3.0)
    assert required(same, predict(same)) == error
