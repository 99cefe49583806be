"""Likelihood ascent: gains what other captures confirm, and leaves alone what noise does not let be judged."""

from itertools import islice

import pytest
import torch

from invert.albedo.registration import on_grid, register_images
from invert.likelihood.gamma import Likelihood, log_likelihood_leads
from invert.likelihood.refinement import LEARNING_RATE, MIN_ALBEDO, _ascent, refine_by_likelihood
from invert.measure.spectrum import Measurement, read_measurement
from radiometry.noise.model import autocorrelate_windowed, draw_estimate
from tests.invert.posterior.steps import RIGHT


def make_measurement(floor: float, dof: float, seed: int) -> Measurement:
    signal = autocorrelate_windowed(RIGHT.double())
    estimate = draw_estimate(floor + signal / signal[63, 64], dof, torch.Generator().manual_seed(seed))
    return read_measurement(estimate.float().numpy())


def likeness(albedo: torch.Tensor) -> float:
    return float(register_images(on_grid(RIGHT.numpy())[None], on_grid(albedo.numpy()))[1])


BLURRY_START = torch.nn.functional.avg_pool2d(torch.nn.functional.pad(RIGHT, (1, 1, 1, 1))[None], 3, 1)[0]


@pytest.mark.parametrize(
    ("floor", "dof", "gain"), [(0.02, 1e4, 0.03), (0.2, 1e4, 0.02), (0.02, 256.0, 0.01), (0.2, 256.0, -0.005)]
)
def test_where_noise_is_low_it_follows_the_data(floor, dof, gain):
    """A blurred start approaches the object, and another capture of it becomes more likely."""
    start = BLURRY_START / BLURRY_START.max()
    found = refine_by_likelihood(start, make_measurement(floor, dof, 0))
    assert float(found.max()) == pytest.approx(1.0)
    assert likeness(found) > likeness(start) + gain
    assert log_likelihood_leads(start.numpy(), found.numpy(), [make_measurement(floor, dof, 1)])[0] > 30.0


@pytest.mark.parametrize("seed", range(4))
def test_where_noise_is_high_it_stays(seed):
    """From the object itself there is nothing to gain: what one half of the lags gains, the other half does not confirm."""
    torch.testing.assert_close(refine_by_likelihood(RIGHT, make_measurement(4.0, 64.0, seed)), RIGHT)


def test_slope_of_the_likelihood():
    """The gradient agrees with finite differences, with gains fitted again."""
    likelihood = Likelihood.of(make_measurement(0.2, 64.0, 2))
    rng = torch.Generator().manual_seed(3)
    albedo = (RIGHT.double() + 0.3 * torch.rand(64, 64, generator=rng, dtype=torch.float64)).requires_grad_()
    way = torch.randn(64, 64, generator=rng, dtype=torch.float64)
    (slope,) = torch.autograd.grad(likelihood(albedo[None]).sum(), albedo)
    with torch.no_grad():
        ahead, behind = (float(likelihood((albedo + step * way)[None])[0]) for step in (1e-4, -1e-4))
    assert float((slope * way).sum()) == pytest.approx((ahead - behind) / 2e-4, rel=1e-3)


def test_ascent_takes_the_steps_of_adam():
    likelihood = Likelihood.of(make_measurement(1.0, 64.0, 0), torch.device("cpu"), torch.float32)
    root = (RIGHT + MIN_ALBEDO).sqrt().requires_grad_()
    adam = torch.optim.Adam([root], lr=LEARNING_RATE)
    for found in islice(_ascent(RIGHT[None], likelihood, likelihood.used), 6):
        torch.testing.assert_close(found[0], root.detach().square())
        adam.zero_grad()
        (-(likelihood.used * likelihood.at(root.square()[None], likelihood.used).by_lag).sum()).backward()
        adam.step()
