"""Slope and curvature of the likelihood in the picture, against autograd and differences; steps along them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from invert.likelihood.data_consistency import ascend_to_deviance, run_data_consistency_steps
from invert.likelihood.forward_model import ForwardModel, half_of, lags_used
from invert.likelihood.gamma import Likelihood
from invert.measure.spectrum import Measurement
from invert.network.features import Observation
from radiometry.noise.measured_noise import NoiseLevel
from radiometry.noise.model import autocorrelate_windowed, draw_estimate

FLOOR, DOF = 0.3, 64.0


@pytest.fixture
def albedo() -> torch.Tensor:
    """Two asymmetric objects."""
    image = torch.zeros(2, 64, 64)
    image[0, 20:31, 18:22], image[0, 27:31, 18:40] = 1.0, 0.6
    image[1, 12:50, 30:33], image[1, 40:44, 33:47] = 0.7, 1.0
    return image


def make_observation(albedo: torch.Tensor, seeds: tuple[int, ...]) -> Observation:
    """An estimate of each albedo, largest lag but zero 1."""
    signal = autocorrelate_windowed(albedo)
    signal = signal / signal[:, 63, 64, None, None]
    estimate = torch.stack(
        [draw_estimate(one + FLOOR, DOF, torch.Generator().manual_seed(seed)) for one, seed in zip(signal, seeds, strict=True)]
    )
    return Observation.from_estimate(estimate, torch.full((len(albedo),), FLOOR), torch.full((len(albedo),), DOF))


def test_the_gradient_is_that_of_the_likelihood(albedo):
    """Autograd through the class that ranks candidates, each estimate by itself."""
    seen = make_observation(albedo, (1, 2))
    guess = (0.8 * albedo.roll(1, -1) + 0.2 * albedo).requires_grad_()
    found = seen.likelihood().at(guess.detach()).gradient()
    for number in range(2):
        shown = Measurement(seen.values[number].numpy(), NoiseLevel(FLOOR, DOF, 40), 1.0, 0.0, 100.0, ())
        likelihood = Likelihood.of(shown, kind=torch.float64)
        (expected,) = torch.autograd.grad(likelihood(guess[number : number + 1].double()).sum(), guess, retain_graph=True)
        ours, theirs = found[number], expected[number]
        assert float((ours - theirs).norm() / theirs.norm()) < 0.02


@pytest.mark.parametrize("lags", [63, 40])
def test_derivatives_with_a_transfer_are_those_of_autograd(lags):
    """Double precision, objects that reach the edge of the window, at any number of lags."""
    rng = torch.Generator().manual_seed(lags)
    albedo = torch.rand(2, lags + 1, lags + 1, generator=rng, dtype=torch.float64)
    transfer = torch.rand(2 * lags + 1, 2 * lags + 1, generator=rng, dtype=torch.float64)
    transfer = transfer + transfer.flip((0, 1))
    estimate = autocorrelate_windowed(albedo.roll(2, 1)) * transfer
    likelihood = Likelihood(
        estimate, estimate.amax((1, 2)) / 5.0, torch.tensor([9.0, 30.0]), exact=True, transfer=transfer.numpy()
    )
    likelihood.rounds = 50  # the fit of the gains shall have converged
    way = torch.rand(albedo.shape, generator=rng, dtype=torch.float64)
    point = albedo.clone().requires_grad_()
    (expected,) = torch.autograd.grad(likelihood(point).sum(), point)
    torch.testing.assert_close(likelihood.at(albedo).gradient(), expected, rtol=1e-6, atol=1e-6 * float(expected.abs().max()))
    ahead, behind = (likelihood(albedo + step * way) for step in (1e-5, -1e-5))
    torch.testing.assert_close((expected * way).sum((1, 2)), (ahead - behind) / 2e-5, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(("exact", "largest"), [(True, 2e-5), (False, 3e-3)])
def test_the_forward_model_is_the_windowed_autocorrelation(exact, largest):
    """Relative to its maximum, for an object that fills the window."""
    albedo = torch.rand(1, 64, 64, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    model = ForwardModel(63, albedo, exact=exact)
    found, expected = model.signal(model.spectrum(albedo).abs().square()), half_of(autocorrelate_windowed(albedo))
    assert float(((found - expected) * lags_used(63)).abs().max() / expected.max()) < largest


@pytest.mark.parametrize("place", [(25, 19), (29, 35), (40, 50), (12, 12)])
def test_information_is_the_diagonal_of_the_curvature(albedo, place):
    """To within a factor of two, in the object and beside it."""
    at = make_observation(albedo, (1, 2)).likelihood().at(albedo)
    unit = torch.zeros_like(albedo)
    unit[(slice(None), *place)] = 1.0
    ratio = at.curvature(unit) / at.information()[(slice(None), *place)]
    assert ((ratio > 0.5) & (ratio < 2.0)).all()


def test_curvature_is_the_derivative_of_the_gradient(albedo):
    """Along a random way, at the truth of an estimate without noise, where the second derivative is the information."""
    truth = albedo[:1]
    seen = make_observation(truth, (6,))
    signal = autocorrelate_windowed(truth)
    seen = replace(seen, values=signal / signal[:, 63, 64, None, None] + FLOOR)
    way = torch.zeros_like(truth)
    way[0, 20:31, 18:22] = torch.rand(11, 4, generator=torch.Generator().manual_seed(7)) - 0.5
    at = seen.likelihood().at(truth)
    # The brightness is fitted for every albedo but kept in the curvature, so along this way it shall not change.
    mixed = 0.25 * (at.curvature(way + truth) - at.curvature(way - truth))
    way = way - truth * float(mixed / at.curvature(truth))
    ahead, behind = (seen.likelihood().at(truth + share * way).gradient() for share in (0.01, -0.01))
    expected = ((behind - ahead) / 0.02 * way).sum()
    assert float(at.curvature(way)) == pytest.approx(float(expected), rel=0.1)


def test_the_deviance_is_one_at_the_truth(albedo):
    """And more where something is missing."""
    truth = albedo[:1].expand(8, -1, -1)
    seen = make_observation(truth, tuple(range(10, 18)))
    deviance = seen.likelihood().at(truth).deviance()
    assert float(deviance.mean()) == pytest.approx(1.0, abs=0.02)
    without_bar = truth.clone()
    without_bar[:, 27:31, 22:40] = 0.0
    assert float((seen.likelihood().at(without_bar).deviance() - deviance).min()) > 0.02


def test_steps_towards_the_data_find_what_is_missing(albedo):
    """A dimmed corner of the object comes back, and the prior holds what the data do not ask to change."""
    seen = make_observation(albedo, (3, 4))
    guess = albedo.clone()
    guess[0, 27:31, 30:40] = 0.2
    moved = run_data_consistency_steps(seen.likelihood(), guess, torch.tensor([0.05, 0.05]), 20)
    missing = (slice(0, 1), slice(27, 31), slice(30, 40))
    assert float(moved[missing].mean()) > 0.35
    assert float((moved[1] - albedo[1]).square().mean().sqrt()) < 0.05
    held = run_data_consistency_steps(seen.likelihood(), guess, torch.tensor([1e-7, 1e-7]), 20)
    np.testing.assert_allclose(held, guess, atol=1e-3)


def test_nothing_is_gained_from_nothing():
    seen = make_observation(torch.ones(1, 64, 64), (5,))
    assert not seen.likelihood().at(torch.zeros(1, 64, 64)).gradient().abs().max() > 1e-3


def test_explained_albedos_are_unchanged(albedo):
    """Steps stop at the deviance asked for, each albedo by itself."""
    seen = make_observation(albedo, (8, 9))
    guess = albedo.clone()
    guess[0] = 0.5 * guess[0] + 0.5 * guess[0].roll(3, 0)
    worse, explained = seen.likelihood().at(guess).deviance().tolist()
    between = 0.5 * (worse + explained)
    assert worse > explained
    moved = ascend_to_deviance(seen.likelihood(), guess, torch.tensor([1.0, 1.0]), torch.tensor([between, between]), 20)
    assert float(seen.likelihood().at(moved).deviance()[0]) == pytest.approx(between, abs=0.1 * (worse - between))
    torch.testing.assert_close(moved[1], guess[1], rtol=0, atol=0)
    assert float((moved[0] - guess[0]).abs().max()) > 0.05
