"""The noise model's own statistics, and predictions at the extremes."""

import json

import numpy as np
import pytest
import torch
from scipy import stats

from correlograph.errors import InputError
from radiometry.estimation.published import published_dof
from radiometry.noise.model import draw_estimate, expected_spectrum, log_likelihood
from radiometry.noise.predicted_floor import NoiseTerms, estimate_error
from radiometry.safety import maximum_permissible_exposure, spot_safety
from radiometry.sensor.electronics import Electronics
from radiometry.sensor.stage import SpeckleLight


def torch_rng(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("dof", [1.0, 2.5, 64.0])
@pytest.mark.parametrize("form", ["gamma", "gaussian"])
def test_samples_have_the_predicted_mean_and_variance(dof, form):
    spectrum = torch.linspace(0.1, 3.0, 9 * 9).reshape(9, 9)
    draws = draw_estimate(spectrum.expand(40000, 9, 9), dof, torch_rng(), form)
    mean, variance = draws.mean(0), draws.var(0)
    off_zero = torch.ones(9, 9, dtype=torch.bool)
    off_zero[4, 4] = False
    np.testing.assert_allclose(mean, spectrum, rtol=6 / np.sqrt(40000 * min(dof, 1.0)))
    np.testing.assert_allclose((variance / spectrum**2)[off_zero], 1 / dof, rtol=0.12)
    assert torch.allclose(draws / spectrum, (draws / spectrum).flip(-1, -2), rtol=1e-5)


def test_the_two_forms_differ_where_they_must():
    flat = torch.ones(127, 127)
    for dof, p_gaussian in ((1.0, 0.0), (3.0, 1e-4)):
        free = draw_estimate(flat, dof, torch_rng(3)).flatten()[: 127**2 // 2].numpy()
        assert stats.kstest(free, stats.gamma(dof, scale=1 / dof).cdf).pvalue > 0.01
        assert stats.kstest(free, stats.norm(1, dof**-0.5).cdf).pvalue <= p_gaussian + 1e-12


def test_dof_per_sample_and_refusals():
    draws = draw_estimate(torch.ones(2, 127, 127), torch.tensor([4.0, 400.0]), torch_rng())
    assert float(draws[0].var()) == pytest.approx(0.25, rel=0.1)
    assert float(draws[1].var()) == pytest.approx(0.0025, rel=0.1)
    with pytest.raises(InputError, match="dof"):
        draw_estimate(torch.ones(3, 3), 0.0, torch_rng())


@pytest.mark.parametrize("form", ["gamma", "gaussian"])
def test_likelihood_peaks_at_the_truth_and_matches_scipy(form):
    signal = torch.rand(127, 127, generator=torch_rng(1))
    signal = 0.5 * (signal + signal.flip(-1, -2))
    truth = expected_spectrum(signal, 0.3)
    estimate = draw_estimate(truth, 16.0, torch_rng(2), form)
    values = [float(log_likelihood(estimate, truth * factor, 16.0, form)) for factor in (0.9, 1.0, 1.1)]
    assert values[1] > max(values[0], values[2])
    half = 127**2 // 2
    x, s = estimate.flatten()[:half].double().numpy(), truth.flatten()[:half].double().numpy()
    law = stats.gamma(16.0, scale=s / 16.0) if form == "gamma" else stats.norm(s, s / 4.0)
    assert values[1] == pytest.approx(law.logpdf(x).sum(), rel=1e-5)


def test_expected_spectrum_filters_the_signal_and_not_the_floor():
    transfer = torch.full((3, 3), 0.25)
    assert torch.equal(expected_spectrum(torch.ones(2, 3, 3), torch.tensor([1.0, 2.0]), transfer)[1], torch.full((3, 3), 2.25))


def test_terms_add_and_scale_with_exposure():
    short, long = (
        NoiseTerms(
            SpeckleLight(0.08 * t, 300.0, ambient=0.2 * t, stray=0.1 * t, detector_speckle=0.8),
            Electronics(t, dark_current=0.01, read_noise=2.0, fixed_pattern=1.0, row_noise=5.0),
        )
        for t in (1.0, 10.0)
    )
    powers = {
        "signal": 1,
        "ambient": 1,
        "other_light": 1,
        "dark_current": 1,
        "read_noise": 2,
        "fixed_pattern": 2,
        "detector_speckle": 0,
    }
    for name, power in powers.items():
        assert short.over_peak()[name] / long.over_peak()[name] == pytest.approx(10.0**power)
    assert short.floor_over_peak() == pytest.approx(sum(short.over_peak().values()))
    assert short.over_peak()["signal"] == pytest.approx(1 / (0.08 * 300))


def test_extremes_stay_finite_or_say_so():
    def floor(**light):
        return NoiseTerms(SpeckleLight(**light), Electronics(1.0)).floor_over_peak()

    assert floor(signal=0.0, grain_pixels=300.0) is None
    assert floor(signal=1.0, grain_pixels=np.inf) is None
    assert floor(signal=1e-200, grain_pixels=300.0) == pytest.approx(1e200 / 300)
    assert floor(signal=0.1, grain_pixels=300.0, ambient=1e5) == pytest.approx(1e5 / (0.01 * 300), rel=1e-5)
    for wrong in (
        {"signal": -1.0},
        {"signal": float("nan")},
        {"signal": 1.0, "stray": -2.0},
        {"signal": 1.0, "grain_pixels": 0.0},
    ):
        with pytest.raises(InputError):
            SpeckleLight(**{"grain_pixels": 300.0, **wrong})


def test_degrees_of_freedom_of_patches_side_by_side():
    assert [published_dof(*pair) for pair in ((2, 64), (50, 25), (1, 64), (1, 1))] == [64, 1225, 63, 0]


def test_error_of_an_estimate_is_the_scatter_of_draws():
    signal = torch.zeros(127, 127)
    signal[50:77, 60:67] = torch.linspace(0.1, 1.0, 27 * 7).reshape(27, 7)
    signal = 0.5 * (signal + signal.flip(-1, -2))
    draws = draw_estimate(expected_spectrum(signal, 0.05).expand(50, 127, 127), 64.0, torch_rng(5)) - 0.05
    measured = ((draws - signal).square().sum((-1, -2)) / signal.square().sum()).mean().sqrt()
    predicted = estimate_error(float(signal.sum()), float((signal**2).sum()), signal.numel(), 0.05, 64.0)
    assert float(measured) == pytest.approx(predicted, rel=0.03)


def test_laser_safety_matches_the_standard():
    assert maximum_permissible_exposure(532e-9) == pytest.approx(25.46, abs=0.01)
    # one milliwatt through a 7 mm pupil: the limit of laser class 2
    assert maximum_permissible_exposure(532e-9) * np.pi / 4 * 7e-3**2 == pytest.approx(1e-3, rel=0.03)
    line = spot_safety(0.3, 532e-9, 5e-3)
    assert line["spot_over_limit"] == pytest.approx(0.3 / (np.pi / 4 * 25e-6) / 25.46, rel=1e-3)
    assert 0.3 / (np.pi * line["hazard_distance_m"] ** 2) == pytest.approx(line["limit_w_per_m2"])
    for wavelength in (355e-9, 1064e-9):
        with pytest.raises(InputError, match="visible"):
            maximum_permissible_exposure(wavelength)
    json.dumps(line, allow_nan=False)
