"""Samples of the posterior of a field: its gradient, its prior, and exchangeability with the truth."""

import numpy as np
import pytest
import torch

from invert.field.counts import FrameCounts
from invert.field.forward_model import ForwardModel, expected_counts, log_likelihood, power
from invert.field.grid import field_grid
from invert.field.posterior import FieldPosterior
from invert.field.sampling import Sampling
from tests.invert.field.test_forward_model import CAMERA, complex_normal

BACKGROUND = 0.3


@pytest.fixture(scope="module")
def model():
    grid = field_grid((130, 171), (120, 104), ((10.0, 14.0), (21.0, 23.0)))
    return ForwardModel(grid, grid.transfer(CAMERA, (0.0, 0.0)))


def draw_prior(grid, rng):
    """Return expected |E|^2 in counts, dark in three rows and from dim to bright elsewhere."""
    prior = torch.from_numpy(rng.random(grid.box_shape).astype(np.float32)) ** 4 * 60.0
    prior[:3] = 0.0
    return prior


def draw_counts(model, field, rng, roughness=0.0, spot=None):
    """Return counts of a field under uneven light, a tenth of the pixels unmeasured.

    Args:
        spot: width of a Gaussian illumination in units of the frame; None for a slope.
    """
    columns = np.linspace(-0.5, 0.5, model.grid.frame_shape[1], dtype=np.float32)
    lit = 1.0 + columns if spot is None else np.exp(-0.5 * (columns / spot) ** 2)
    lit = torch.from_numpy(lit / lit.mean()).expand(model.grid.frame_shape)
    expected = (lit * model.intensity(model.grid.to_wall(field)) + BACKGROUND).numpy()
    spread = rng.gamma(1.0 / roughness, roughness, expected.shape) if roughness else 1.0
    values = torch.from_numpy(rng.poisson(expected * spread).astype(np.float32))
    fitted = torch.from_numpy(rng.random(expected.shape) > 0.1)
    return FrameCounts(values, values, fitted, ~fitted, lit, BACKGROUND, float(values.mean()) - BACKGROUND, roughness)


def energy(model, counts, prior, field):
    """Return the negative log-posterior of a field, from its definition."""
    expected = expected_counts(model.intensity(model.grid.to_wall(field)), counts)
    likelihood = (counts.fitted * log_likelihood(counts.values, expected, counts.roughness)).sum(dtype=torch.float64)
    free = prior > 0.0
    return float((power(field)[:, free] / prior[free]).sum(dtype=torch.float64) - likelihood)


@pytest.mark.parametrize(("modes", "roughness"), [(1, 0.0), (2, 0.3)])
def test_the_gradient_is_the_derivative_of_the_posterior(model, rng, modes, roughness):
    prior = draw_prior(model.grid, rng)
    field = complex_normal((modes, *model.grid.box_shape), rng) * (0.5 * prior).sqrt()
    counts = draw_counts(model, field, rng, roughness)
    posterior = FieldPosterior(model, counts, prior)
    scaled, direction = posterior.scale(field), complex_normal(field.shape, rng)
    assert torch.allclose(posterior.field(scaled), field, atol=1e-4)
    step = 1e-2
    numerical = energy(model, counts, prior, posterior.field(scaled + step * direction))
    numerical -= energy(model, counts, prior, posterior.field(scaled - step * direction))
    gradient, expected = posterior.gradient(scaled)
    assert float((gradient.conj() * direction).real.sum()) == pytest.approx(numerical / (2.0 * step), rel=2e-2)
    assert torch.allclose(expected, expected_counts(model.intensity(model.grid.to_wall(field)), counts), rtol=1e-3)


def test_without_data_the_samples_are_those_of_the_prior(model, rng):
    prior = draw_prior(model.grid, rng)
    counts = draw_counts(model, complex_normal((1, *model.grid.box_shape), rng), rng)
    nothing = FrameCounts(**{**vars(counts), "fitted": torch.zeros_like(counts.fitted)})
    posterior = FieldPosterior(model, nothing, prior)
    mean = Sampling(posterior, torch.Generator().manual_seed(1)).run(
        torch.zeros(1, *prior.shape, dtype=torch.complex64), 100, 900
    )
    assert not mean.power[:, :3].any()
    assert float(mean.power.sum() / prior.sum()) == pytest.approx(1.0, abs=0.1)
    strong = prior > 20.0
    assert float(power(mean.field)[0][strong].sum() / prior[strong].sum()) < 0.3


@pytest.mark.parametrize(("modes", "spot"), [(1, None), (2, None), (1, 0.1)])
def test_samples_and_truth_are_exchangeable(model, modes, spot):
    """Started at the truth, itself a sample, chains have its energy on average; those with too long steps have a higher one."""
    excess, deviation = [], []
    for seed in range(12):
        rng = np.random.default_rng([seed, modes])
        prior = draw_prior(model.grid, rng)
        truth = complex_normal((modes, *prior.shape), rng) * (0.5 * prior).sqrt()
        counts = draw_counts(model, truth, rng, spot=spot)
        posterior = FieldPosterior(model, counts, prior)
        sampling = Sampling(posterior, torch.Generator().manual_seed(seed))
        state = sampling.init(truth)
        energies = []
        for number in range(120):
            sampling.step(state)
            if number >= 40 and number % 8 == 0:
                energies.append(energy(model, counts, prior, posterior.field(state.field)))
        excess.append(np.mean(energies) - energy(model, counts, prior, truth))
        deviation.append(np.std(energies))
    assert abs(np.mean(excess)) < 4.0 * np.mean(deviation) * np.sqrt((1.0 + 0.3) / len(excess))
