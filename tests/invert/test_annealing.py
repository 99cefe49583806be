"""The sampler and its rounds: shapes of its task, repeatable draws, and samples that stay with the data."""

import pytest
import torch

from invert.likelihood import log_likelihoods
from invert.network.annealing import Annealing, Drawn, posterior_samples
from invert.network.checkpoints import SHIPPED, load_network
from invert.network.inference import observation
from invert.registration import on_grid, registered
from invert.training.data import at_noise, hidden_in_noise
from invert.training.objectives import DenoisedPicture
from tests.invert.steps import RIGHT, noisy

FEW = Annealing(samples=4, steps=4, ascent=4, rounds=1)


@pytest.fixture(scope="module")
def sampler():
    return load_network(SHIPPED)[0].sampler


def drawn(sampler, starts: torch.Tensor, seed: int) -> Drawn:
    measurement = noisy()
    return posterior_samples(sampler, observation([measurement]), measurement.noise.inflation, starts, FEW,
                             torch.Generator().manual_seed(seed))


def test_samples_come_nearer_to_the_object(sampler):
    """From its blurred picture: likelier, and more like it; another seed draws others."""
    blurred = torch.nn.functional.avg_pool2d(RIGHT[None], 7, 1, 3)
    samples = drawn(sampler, (blurred / blurred.max()).expand(6, -1, -1), 1).samples
    assert samples.shape == (4, 64, 64)
    torch.testing.assert_close(samples.amax((-2, -1)), torch.ones(4))
    before, after = (registered(torch.stack([on_grid(one.numpy()) for one in images]), on_grid(RIGHT.numpy()))[1]
                     for images in (blurred, samples))
    assert float(after.min()) > float(before[0]) + 0.02
    assert float((log_likelihoods(samples, noisy()) - log_likelihoods(blurred, noisy())).min()) > 100.0
    torch.testing.assert_close(drawn(sampler, (blurred / blurred.max()).expand(6, -1, -1), 1).samples, samples)
    assert float((drawn(sampler, (blurred / blurred.max()).expand(6, -1, -1), 2).samples - samples).abs().max()) > 0.01


def test_the_sampler_removes_noise(sampler):
    """Of the share of an albedo's energy that noise of 0.7 hides (eleven times the energy), a quarter is left at most."""
    batch = at_noise(RIGHT[None].expand(4, -1, -1), 0.3, 64.0, torch.Generator().manual_seed(3))
    with torch.no_grad():
        missed = DenoisedPicture().achieved(sampler, hidden_in_noise(batch, torch.Generator().manual_seed(4)))
    assert missed < 0.25


def test_its_task_is_the_same_on_any_number_of_processes():
    """Shares of a batch hold what the whole holds; objects stay whole when they move."""
    batch = hidden_in_noise(at_noise(RIGHT[None].expand(6, -1, -1), 0.3, 64.0, torch.Generator().manual_seed(5)),
                            torch.Generator().manual_seed(6))
    share = batch.part(slice(1, None, 2), "cpu")
    torch.testing.assert_close(share.truth, batch.truth[1::2])
    torch.testing.assert_close(share.draws.noise, batch.draws.noise[:, 1::2])
    torch.testing.assert_close(share.draws.sigma, batch.draws.sigma[1::2])
    torch.testing.assert_close(batch.truth.sum((-2, -1)), RIGHT.sum().expand(6))
    assert len({tuple(one.nonzero()[0].tolist()) for one in batch.truth}) > 1
