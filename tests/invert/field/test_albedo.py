"""Despeckling, resolution and the certificate: closed forms, limits, and error rates."""

import numpy as np
import pytest
import torch
from scipy import ndimage

from invert.field.certificate import MAX_FALSE_ACCEPTANCE, MIN_GAIN_SIGMA, Certificate, predict_held_out
from invert.field.counts import FrameCounts
from invert.field.despeckling import despeckle, smooth_by_total_variation
from invert.field.resolution import fourier_ring_correlation, resolution_of_halves


def looks_of(albedo, looks, rng):
    return torch.from_numpy(albedo * rng.exponential(1.0, (looks, *albedo.shape))).float()


def test_without_total_variation_the_albedo_is_the_mean_of_the_looks(rng):
    intensity = looks_of(0.5 + rng.random((31, 44)), 5, rng).mean(0)
    found = smooth_by_total_variation(intensity, 5, 1e-9)
    assert found.numpy() == pytest.approx(intensity.numpy(), rel=0.02)


def test_with_strong_total_variation_it_is_the_likeliest_constant(rng):
    """The likelihood of looks with one mean is highest at the mean of all of them."""
    intensity = looks_of(np.full((24, 37), 3.0), 4, rng).mean(0)
    assert smooth_by_total_variation(intensity, 4, 50.0).numpy() == pytest.approx(float(intensity.mean()), rel=0.05)


@pytest.mark.parametrize("looks", [2, 10])
def test_despeckling_restores_edges_and_states_its_deviation(rng, looks):
    albedo = np.full((90, 120), 0.02)
    albedo[20:70, 30:50] = albedo[20:34, 30:100] = 1.0
    found = despeckle(looks_of(albedo, looks, rng))
    mean = looks_of(albedo, looks, rng).mean(0).numpy()
    correlation = np.corrcoef(found.albedo.numpy().ravel(), albedo.ravel())[0, 1]
    assert correlation > 0.97
    assert correlation > np.corrcoef(mean.ravel(), albedo.ravel())[0, 1] + 0.02
    inside = ndimage.binary_erosion(albedo > 0.5, iterations=4)
    error = np.abs(found.albedo.numpy() - albedo)[inside]
    assert found.deviation.numpy()[inside].mean() == pytest.approx((error**2).mean() ** 0.5, rel=0.7)


def test_one_look_has_neither_deviation_nor_resolution(rng):
    found = despeckle(looks_of(np.ones((20, 30)), 1, rng))
    assert found.deviation is None
    assert found.resolution((1.0, 1.0)) is None


@pytest.mark.parametrize("cutoff", [0.1, 0.2, 0.3])
def test_resolution_is_the_band_limit_of_the_shared_signal(rng, cutoff):
    signal = np.fft.fft2(rng.standard_normal((160, 200)))
    frequency = np.hypot(np.fft.fftfreq(160)[:, None], np.fft.fftfreq(200)[None])
    shared = np.fft.ifft2(signal * (frequency < cutoff)).real
    halves = [shared + 0.3 * rng.standard_normal(shared.shape) for _ in range(2)]
    assert resolution_of_halves(*halves, (2.0, 2.0)) == pytest.approx(1.0 / cutoff, rel=0.12)
    frequencies, correlation = fourier_ring_correlation(*halves, (2.0, 2.0))
    assert correlation[2.0 * frequencies < 0.8 * cutoff].min() > 0.5


def test_the_certificate_accepts_chance_at_its_stated_rate(rng):
    """Two predictions that are equally far from the truth: the gain is symmetric around zero with the stated error."""
    sigmas = []
    for _ in range(400):
        true = torch.from_numpy(rng.exponential(3.0, (40, 50)))
        values = torch.poisson(true, generator=torch.Generator().manual_seed(int(rng.integers(2**31))))
        everywhere = torch.ones_like(true, dtype=torch.bool)
        counts = FrameCounts(values, everywhere, everywhere, torch.ones(()), 0.0, 3.0)
        first, second = (true * torch.from_numpy(np.exp(0.3 * rng.standard_normal(true.shape))) for _ in range(2))
        sigmas.append(Certificate.of([predict_held_out(counts, first, second)]).gain_sigma)
    assert np.mean(sigmas) == pytest.approx(0.0, abs=0.2)
    assert np.std(sigmas) == pytest.approx(1.0, abs=0.15)
    assert np.mean(np.array(sigmas) > MIN_GAIN_SIGMA) <= 4.0 * MAX_FALSE_ACCEPTANCE + 0.005


def test_the_certificate_prefers_the_truth(rng):
    true = torch.from_numpy(rng.exponential(3.0, (60, 50)))
    values = torch.poisson(true, generator=torch.Generator().manual_seed(3))
    everywhere = torch.ones_like(true, dtype=torch.bool)
    counts = FrameCounts(values, everywhere, everywhere, torch.ones(()), 0.0, 3.0)
    blurred = torch.nn.functional.avg_pool2d(true[None], 3, 1, 1)[0]
    found = Certificate.of([predict_held_out(counts, true, blurred)])
    assert found.is_accepted
    assert found.chi_squared_field == pytest.approx(1.0, abs=0.1)
    assert found == Certificate.from_dict(found.as_dict())
