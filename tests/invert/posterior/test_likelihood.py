"""Likelihood of an estimate of candidates: the noise model's, and blind to what an autocorrelation cannot tell."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import minimize, nnls

from correlograph.lags import LAGS, lag_grid
from invert.albedo.posterior import Samples
from invert.assess.doubts import DoubtKind
from invert.assess.reliability import find_doubts, lower_confidence
from invert.likelihood.forward_model import _least_squares_gains
from invert.likelihood.gamma import Likelihood, log_likelihood_leads
from invert.measure.spectrum import read_measurement
from invert.methods import Reconstruction
from invert.training.data import at_noise
from radiometry.noise.measured_noise import NoiseLevel
from radiometry.noise.model import autocorrelate_windowed, draw_estimate, log_likelihood
from tests.invert.posterior.steps import MIRRORED_STEM, RIGHT, noisy

RING = lag_grid(LAGS).ring


def pedestal(lags: float) -> torch.Tensor:
    """Return a pedestal of a width in lags, 1 at zero lag; (127, 127)."""
    lag = torch.arange(-63, 64).double()
    return torch.exp(-(lag[:, None] ** 2 + lag**2) / (2.0 * lags**2))


def test_likelihoods_are_those_of_the_noise_model():
    """Differences between candidates are those of `log_likelihood` at each one's likeliest brightness and pedestal."""
    albedos = torch.stack((RIGHT, MIRRORED_STEM, RIGHT + 0.02 * MIRRORED_STEM))
    near = torch.from_numpy(RING <= 1)  # the same for all
    noise, estimate = noisy().noise, torch.from_numpy(noisy().values).double().masked_fill(near, 1.0)

    def at_best(albedo: torch.Tensor) -> float:
        def cost(parameters: np.ndarray) -> float:
            bright, faint = parameters
            expected = noise.floor + float(bright) * autocorrelate_windowed(albedo.double()) + float(faint) * pedestal(32.0)
            return -float(log_likelihood(estimate, expected.masked_fill(near, 1.0), noise.dof))

        return -minimize(
            cost,
            (1e-3, 1e-3),
            method="Nelder-Mead",
            bounds=((0.0, 1.0), (0.0, 1.0)),
            options={"xatol": 1e-9, "fatol": 1e-6, "maxiter": 2000},
        ).fun

    found, wanted = Likelihood.of(noisy())(albedos), torch.tensor([at_best(one) for one in albedos])
    torch.testing.assert_close(found - found[0], wanted - wanted[0], rtol=1e-3, atol=0.05, check_dtype=False)
    assert float(found[0] - found[1]) > 20.0


@pytest.mark.parametrize("unit", [1e-30, 1.0, 1e30])
def test_likelihood_knows_no_shift_turn_brightness_or_unit(unit):
    same = torch.stack((RIGHT, 7.0 * RIGHT, torch.roll(RIGHT, (5, -3), (0, 1)), RIGHT.flip((0, 1))))
    noise = replace(noisy().noise, floor=unit * noisy().noise.floor)
    scaled = replace(noisy(), values=np.float32(unit) * noisy().values, noise=noise)
    found = Likelihood.of(scaled)(same)
    assert float((found - Likelihood.of(noisy())(RIGHT[None])).abs().max()) < 0.02


def test_likelihood_of_an_empty_candidate_and_without_noise():
    """An empty candidate is less likely than a wrong one; without noise the truth is the likeliest."""
    blank = Likelihood.of(noisy())(torch.stack((torch.zeros(64, 64), MIRRORED_STEM)))
    assert torch.isfinite(blank).all()
    assert blank[1] > blank[0]
    silent = read_measurement(autocorrelate_windowed(RIGHT).numpy())
    found = Likelihood.of(silent)(torch.stack((MIRRORED_STEM, RIGHT)))
    assert torch.isfinite(found).all()
    assert found[1] > found[0]


@pytest.mark.parametrize("floor", [0.0, 1e-5, 3e-4])
def test_little_noise_leaves_the_object_its_own_likelihood(floor):
    """An estimate without noise is the object's own expectation, so that nothing is left unexplained, and a blur explains less."""
    spectrum = autocorrelate_windowed(RIGHT)
    lag = torch.arange(-63, 64)
    blur = torch.exp(-0.5 * (lag[:, None] ** 2 + lag**2) / 60.0**2).numpy()
    noise = NoiseLevel(floor, 100.0, 40)
    shown = replace(read_measurement((floor + spectrum / spectrum.max()).float().numpy()), noise=noise)
    own, blurred = (float(Likelihood.of(shown, transfer=transfer)(RIGHT[None])) for transfer in (None, blur))
    assert -1.0 < own <= 0.0
    assert blurred < own - 10.0


@pytest.mark.parametrize(("lags", "light"), [(24.0, 0.01), (32.0, 0.003), (40.0, 0.003)])
def test_a_pedestal_is_not_taken_for_the_object(lags, light):
    """Faint light all over the window would explain some of a pedestal; the object without it is still more likely."""
    smeared = RIGHT + light
    spectrum = autocorrelate_windowed(RIGHT).double()
    spectrum = 0.1 + spectrum / spectrum.max() + 0.03 * pedestal(lags)
    drawn = draw_estimate(spectrum, 256.0, torch.Generator().manual_seed(3))
    shown = replace(read_measurement(drawn.float().numpy()), noise=NoiseLevel(0.1, 256.0, 40))
    right, wrong = Likelihood.of(shown)(torch.stack((RIGHT, smeared))).tolist()
    assert right - wrong > 5.0


def test_misfit_is_that_of_noise_for_the_object_and_more_for_others():
    """The object's own is noise about zero: a sum over lags of variance 1 / 2 each, in nats, at large K."""
    misfits = []
    for seed in range(6):
        estimate = at_noise(RIGHT[None], 0.3, 64.0, torch.Generator().manual_seed(seed)).seen.values[0]
        likelihood = Likelihood.of(read_measurement(estimate.numpy()))
        misfits.append([likelihood.misfit(one) for one in (RIGHT, MIRRORED_STEM, torch.zeros(64, 64))])
    right, wrong, nothing = np.mean(misfits, 0)
    assert abs(right) < 4.0 * (likelihood.lags / 2.0 / len(misfits)) ** 0.5
    assert wrong > right + 20.0
    assert nothing > wrong + 200.0


def test_samples_that_leave_the_estimate_unexplained_are_doubted():
    """A bar without its stem misses what shows the stem; the object with noise of its own does not."""
    measurement, found = noisy(), Reconstruction(RIGHT.numpy(), True, 0.9, None)
    without_stem = torch.where(RIGHT.sum(1, keepdim=True) > RIGHT.sum(1).max() - 0.5, RIGHT, 0.0)
    for sample, doubted in ((RIGHT, False), (without_stem, True)):
        drawn = Samples(np.stack([sample.numpy()] * 3).astype(np.float32))
        (doubt,) = find_doubts(replace(found, posterior=drawn), None, lambda: Likelihood.of(measurement), None)
        assert doubt.kind is DoubtKind.UNLIKELY_SAMPLES
        assert doubt.is_raised is doubted
        assert lower_confidence(found, (doubt,)).confidence == (0.5 if doubted else 0.9)


def test_brightnesses_are_those_of_non_negative_least_squares():
    """Against scipy, with either, neither and both of the two at zero."""
    rng, zeros = np.random.default_rng(4), set()
    for _ in range(60):
        signal, pedestal, weight = rng.random(9), rng.random(9), rng.random(9)
        excess = rng.normal(size=2) @ (signal, pedestal) + 0.3 * rng.normal(size=9)
        wanted, _ = nnls(np.sqrt(weight)[:, None] * np.stack((signal, pedestal), 1), np.sqrt(weight) * excess)
        found = _least_squares_gains(*map(torch.from_numpy, (signal[None], pedestal, excess, weight[None])))
        np.testing.assert_allclose([float(one) for one in found], wanted, atol=1e-9)
        zeros.add(tuple(wanted > 0.0))
    assert len(zeros) == 4


def test_other_captures_judge_a_picture():
    """Independent estimates of one object prefer it to a wrong turn, each by what the noise model says."""
    spectrum = autocorrelate_windowed(RIGHT).double()
    spectrum = 0.3 + spectrum / spectrum.max()
    captures = [
        read_measurement(draw_estimate(spectrum, 64.0, torch.Generator().manual_seed(seed)).float().numpy())
        for seed in range(3)
    ]
    ahead = log_likelihood_leads(MIRRORED_STEM.numpy(), RIGHT.numpy(), captures)
    assert min(ahead) > 20.0
    both = torch.stack((RIGHT, MIRRORED_STEM))
    assert ahead == [pytest.approx(float(torch.sub(*Likelihood.of(capture)(both)))) for capture in captures]
