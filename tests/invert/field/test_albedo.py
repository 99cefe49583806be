"""Despeckling, resolution and the certificate: closed forms, limits, and error rates."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import ndimage
from scipy.stats import norm

from invert.field.blending import blend_with_coarse
from invert.field.certificate import MAX_CANDIDATES, MAX_FALSE_ACCEPTANCE, MIN_GAIN_SIGMA, Certificate, predict_held_out
from invert.field.counts import FrameCounts
from invert.field.despeckling import despeckle
from invert.field.reconstruction import FieldReconstruction
from invert.field.total_variation import smooth_by_total_variation


def looks_of(albedo, looks, rng):
    """Return |E|^2 (frames, 1 mode, rows, columns)."""
    return torch.from_numpy(albedo * rng.exponential(1.0, (looks, 1, *albedo.shape))).float()


def test_without_total_variation_the_albedo_is_the_mean_of_the_looks(rng):
    intensity = looks_of(0.5 + rng.random((31, 44)), 5, rng).mean((0, 1))
    found = smooth_by_total_variation(intensity, 5, 1e-9)
    assert found.numpy() == pytest.approx(intensity.numpy(), rel=0.02)


def test_with_strong_total_variation_it_is_the_likeliest_constant(rng):
    """The likelihood of looks with one mean is highest at the mean of all of them."""
    intensity = looks_of(np.full((24, 37), 3.0), 4, rng).mean((0, 1))
    assert smooth_by_total_variation(intensity, 4, 50.0).numpy() == pytest.approx(float(intensity.mean()), rel=0.05)


@pytest.mark.parametrize("looks", [2, 10])
def test_despeckling_restores_edges_and_states_its_deviation(rng, looks):
    albedo = np.full((90, 120), 0.02)
    albedo[20:70, 30:50] = albedo[20:34, 30:100] = 1.0
    found = despeckle(looks_of(albedo, looks, rng))
    mean = looks_of(albedo, looks, rng).mean((0, 1)).numpy()
    correlation = np.corrcoef(found.albedo.numpy().ravel(), albedo.ravel())[0, 1]
    assert correlation > 0.97
    assert correlation > np.corrcoef(mean.ravel(), albedo.ravel())[0, 1] + 0.02
    inside = ndimage.binary_erosion(albedo > 0.5, iterations=4)
    error = np.abs(found.albedo.numpy() - albedo)[inside]
    assert found.deviation.numpy()[inside].mean() == pytest.approx((error**2).mean() ** 0.5, rel=0.7)


def test_one_frame_has_neither_deviation_nor_resolution(rng):
    found = despeckle(looks_of(np.ones((20, 30)), 1, rng))
    assert found.deviation is None
    assert found.resolution((1.0, 1.0)) is None


@pytest.mark.parametrize("noise", [0.3, 1.0, 2.0])
def test_confidence_is_the_correlation_of_the_mean_of_both_halves_with_their_expectation(rng, noise):
    signal = rng.standard_normal((200, 220))
    halves = [signal + noise * rng.standard_normal(signal.shape) for _ in range(2)]
    agreement = float(np.corrcoef(halves[0].ravel(), halves[1].ravel())[0, 1])
    expected = float(np.corrcoef((halves[0] + halves[1]).ravel(), signal.ravel())[0, 1])
    certificate = Certificate(100, 0.1, 0.01, 4.0, 1.5, 1.1)
    found = FieldReconstruction(signal, 1, certificate, 2, 2, 1.0, 1.0, agreement, 10.0, 0.0, 0.1)
    assert found.confidence == pytest.approx(expected, abs=0.01)
    assert replace(found, agreement=None).confidence is None


def test_two_modes_of_one_frame_are_no_halves(rng):
    looks = torch.from_numpy(rng.exponential(1.0, (1, 2, 20, 30))).float()
    assert despeckle(looks).halves is None


def test_the_certificate_accepts_chance_at_its_stated_rate(rng):
    """Two predictions with equal errors, which are correlated over three pixels: the gain has a mean of zero and the stated error."""
    shape, sigmas = (192, 240), []
    for _ in range(200):
        true = torch.from_numpy(rng.exponential(3.0, shape))
        values = torch.poisson(true, generator=torch.Generator().manual_seed(int(rng.integers(2**31))))
        held_out = torch.from_numpy(rng.random(shape) < 0.3)
        counts = FrameCounts(values, values, ~held_out, held_out, torch.ones(()), 0.0, 3.0)
        errors = (ndimage.uniform_filter(rng.standard_normal(shape), 3) for _ in range(2))
        first, second = (true * torch.from_numpy(np.exp(error)) for error in errors)
        sigmas.append(Certificate.of([predict_held_out(counts, first, second)]).gain_sigma)
    assert np.mean(sigmas) == pytest.approx(0.0, abs=0.2)
    assert np.std(sigmas) == pytest.approx(1.0, abs=0.15)
    assert norm.sf(MIN_GAIN_SIGMA) * MAX_CANDIDATES == pytest.approx(MAX_FALSE_ACCEPTANCE)
    assert max(sigmas) < MIN_GAIN_SIGMA


def test_the_certificate_prefers_the_truth(rng):
    true = torch.from_numpy(rng.exponential(3.0, (60, 50)))
    values = torch.poisson(true, generator=torch.Generator().manual_seed(3))
    everywhere = torch.ones_like(true, dtype=torch.bool)
    counts = FrameCounts(values, values, everywhere, everywhere, torch.ones(()), 0.0, 3.0)
    blurred = torch.nn.functional.avg_pool2d(true[None], 3, 1, 1)[0]
    found = Certificate.of([predict_held_out(counts, true, blurred)])
    assert found.is_accepted
    assert found.chi_squared_field == pytest.approx(1.0, abs=0.1)
    assert found == Certificate.from_dict(found.as_dict())


def test_the_blend_has_lower_errors_than_both_at_the_scale_of_a_lag(rng):
    """Fine albedo with four looks per lag, coarse albedo with a correlation of 0.94."""
    truth = ndimage.gaussian_filter((rng.random((40, 40)) > 0.9).astype(float), 1.2)
    cells = 3
    large = ndimage.zoom(truth, cells, order=3, mode="grid-constant", grid_mode=True).clip(0.0)
    fine = large * rng.gamma(0.45, 1.0 / 0.45, large.shape)
    coarse = (truth + 0.36 * truth.std() * rng.standard_normal(truth.shape)).clip(0.0)
    confidence = float(np.corrcoef(coarse.ravel(), truth.ravel())[0, 1])
    blend, weight = blend_with_coarse(fine, coarse, 0.45 * cells**2, confidence)
    assert 0.05 < weight < 0.5

    def correlation(image):
        means = image.reshape(40, cells, 40, cells).mean((1, 3)) if len(image) > 40 else image
        return np.corrcoef(means.ravel(), truth.ravel())[0, 1]

    assert correlation(blend) > max(correlation(fine), correlation(coarse))


def test_many_looks_leave_the_fine_albedo_alone(rng):
    fine, coarse = rng.random((60, 60)), rng.random((20, 20))
    blend, weight = blend_with_coarse(fine, coarse, 1e6, 0.8)
    assert weight == pytest.approx(1.0, abs=1e-4)
    assert blend == pytest.approx(fine, abs=1e-3)
    blend, weight = blend_with_coarse(fine, coarse, 1e-6, 0.8)
    assert weight < 1e-5
    means = blend.reshape(20, 3, 20, 3).mean((1, 3))
    assert np.corrcoef(means.ravel(), coarse.ravel())[0, 1] > 0.95
