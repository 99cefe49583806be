"""The sampler and its rounds: shapes of its task, repeatable draws, and samples that are found from noise alone."""

from dataclasses import replace

import pytest
import torch

from correlograph.progress import Progress, no_progress
from invert.albedo.registration import register_images, zero_pad
from invert.choices import DEFAULT_WEIGHTS
from invert.likelihood.data_consistency import run_data_consistency_steps
from invert.likelihood.gamma import Likelihood
from invert.network.annealing import INITIAL_SCHEDULE, Annealing, AnnealingResult, Chain, sample_posterior
from invert.network.checkpoints import load_network
from invert.network.data_steps import (
    PRIOR_VARIANCE_FACTOR,
    REPLACEMENT_MARGIN_NATS,
    end_at_deviance_of_truth,
    floor_fraction,
    replace_unlikely_samples,
    take_shrunken_steps,
)
from invert.network.features import Observation
from invert.network.inference import make_observation
from invert.network.sampler import posterior_variance
from invert.training.data import at_noise, hidden_in_noise
from invert.training.objectives import DenoisedPicture
from tests.invert.posterior.steps import MIRRORED_STEM, RIGHT, noisy

FEW = Annealing(samples=4, rounds=1, steps=4, ascent=4)


@pytest.fixture(scope="module")
def sampler():
    return load_network(DEFAULT_WEIGHTS)[0].sampler


def drawn(sampler, seed: int, options: Annealing = FEW, progress: Progress = no_progress) -> AnnealingResult:
    measurement = noisy()
    rng = torch.Generator().manual_seed(seed)
    chain = Chain(sampler, make_observation([measurement]), measurement.noise.inflation, rng, progress)
    return sample_posterior(chain, torch.zeros(1, 64, 64), options)


@pytest.mark.slow
def test_samples_come_from_noise_to_the_object(sampler):
    """Samples from noise resemble the object; another seed gives other samples."""
    found = drawn(sampler, 1)
    assert found.samples.shape == found.denoised_means.shape == (4, 64, 64)
    torch.testing.assert_close(found.samples.amax((-2, -1)), torch.ones(4))
    likeness = register_images(zero_pad(found.samples), zero_pad(RIGHT))[1]
    assert float(likeness.min()) > 0.6
    assert float(likeness.median()) > 0.7
    blurred, likelihood = torch.nn.functional.avg_pool2d(RIGHT[None], 7, 1, 3), Likelihood.of(noisy())
    assert float((likelihood(found.samples) - likelihood(blurred)).min()) > 100.0
    torch.testing.assert_close(drawn(sampler, 1).samples, found.samples)
    assert float((drawn(sampler, 2).samples - found.samples).abs().max()) > 0.01


@pytest.mark.parametrize(("converged", "rounds"), [(1.0, 3), (0.0, 2)])
def test_rounds_end_when_the_mean_has_converged(sampler, converged, rounds):
    """All three rounds for a correlation that is never reached, two for one that always is; the same number of progress steps."""
    steps: list[int] = []
    options = replace(FEW, rounds=3, converged=converged)
    found = drawn(sampler, 1, options, lambda count=1: steps.append(count))
    assert len(found.denoised_means) == rounds * options.samples
    assert sum(steps) == INITIAL_SCHEDULE["steps"] + (3 + 1) * options.steps


@pytest.mark.parametrize("unit", [1e-3, 1.0, 50.0])
def test_floor_fraction_is_dimensionless(unit):
    """Lags of 3 beside zero lag over a floor of 1: a third, in any unit, whatever zero lag is; over 4: all."""
    estimate = torch.ones(2, 127, 127)
    estimate[:, 60:67, 60:67] = 3.0
    estimate[:, 63, 63] = 1000.0
    seen = Observation.from_estimate(unit * estimate, unit * torch.tensor([1.0, 4.0]), torch.tensor([64.0, 64.0]))
    torch.testing.assert_close(floor_fraction(seen), torch.tensor([1.0 / 3.0, 1.0]))


def test_resampling_replaces_the_least_likely():
    """The two least likely of six samples become copies of the two most likely, or of a more likely candidate."""
    measurement = noisy()
    data = make_observation([measurement])
    faint = torch.nn.functional.avg_pool2d(RIGHT[None], 3, 1, 1)[0]
    drawn = torch.stack((MIRRORED_STEM.mT, faint, RIGHT.mT, faint.roll(1, 0), MIRRORED_STEM, faint.roll(2, 0)))
    nats = Likelihood.of(measurement)(drawn)
    worst = nats.argsort()[:2].tolist()
    assert float(nats[worst].max()) < float(nats.max()) - 2.0 * REPLACEMENT_MARGIN_NATS
    kept = replace_unlikely_samples(data, drawn, drawn[:0])
    after = Likelihood.of(measurement)(kept)
    for number in range(6):
        torch.testing.assert_close(after[number], nats.max() if number in worst else nats[number], atol=1.0, rtol=0.0)
    kept = replace_unlikely_samples(data, drawn, RIGHT[None])
    torch.testing.assert_close(kept[worst[0]], RIGHT)
    torch.testing.assert_close(replace_unlikely_samples(data, RIGHT.expand(6, -1, -1), faint[None]), RIGHT.expand(6, -1, -1))


@pytest.mark.parametrize(("dof", "begun"), [(16.0, 1.06), (64.0, 1.1)])
def test_deviance_matches_that_of_truths(dof, begun):
    """Samples of a wrong brightness end at deviances of the mean and the variance that those of 200 truths with their own noise have."""
    truths = at_noise(RIGHT[None].expand(200, -1, -1), 0.3, dof, torch.Generator().manual_seed(9)).seen
    of_truths = truths.likelihood().at(RIGHT[None].expand(200, -1, -1)).deviance()
    data = truths.part(slice(0, 1), "cpu")
    dimmed = RIGHT.clone()
    dimmed[14:19] = 0.0
    wrong = dimmed.expand(50, -1, -1)
    assert float(data.likelihood().at(wrong).deviance().min()) > max(begun, float(of_truths.max()))
    normal = torch.randn(50, generator=torch.Generator().manual_seed(10))
    found = data.likelihood().at(end_at_deviance_of_truth(data, wrong, torch.full((50,), 0.8), 1.0, normal)).deviance()
    error = float(of_truths.std())
    assert abs(float(found.mean() - of_truths.mean())) < 0.4 * error  # of 50, 0.16 by chance
    assert 0.7 * error < float(found.std()) < 1.4 * error
    assert float(torch.corrcoef(torch.stack((found, normal)))[0, 1]) > 0.98


@pytest.mark.parametrize("seed", [6, 7, 8])
def test_steps_that_follow_noise_are_taken_back(seed):
    """A fifth and more of those from the truth, hardly any of those from a wrong object."""
    data, sigma = at_noise(RIGHT[None], 0.3, 64.0, torch.Generator().manual_seed(seed)).seen, torch.tensor([0.8])
    kept = []
    for begun in (RIGHT[None], MIRRORED_STEM[None]):
        all_of_them = (
            run_data_consistency_steps(data.likelihood(), begun, PRIOR_VARIANCE_FACTOR * posterior_variance(sigma), 8) - begun
        )
        kept.append(
            float(((take_shrunken_steps(data, begun, sigma, 8) - begun) * all_of_them).sum() / all_of_them.square().sum())
        )
    assert kept[0] < 0.82
    assert kept[1] > 0.95


def test_the_sampler_removes_noise(sampler):
    """At most a quarter of the energy hidden by noise of sigma 0.7 remains."""
    batch = at_noise(RIGHT[None].expand(4, -1, -1), 0.3, 64.0, torch.Generator().manual_seed(3))
    with torch.no_grad():
        missed = DenoisedPicture().measure_progress(sampler, hidden_in_noise(batch, torch.Generator().manual_seed(4)))
    assert missed < 0.25


def test_its_task_is_the_same_on_any_number_of_processes():
    """Shares of a batch hold what the whole holds; objects stay whole when they move."""
    batch = hidden_in_noise(
        at_noise(RIGHT[None].expand(6, -1, -1), 0.3, 64.0, torch.Generator().manual_seed(5)), torch.Generator().manual_seed(6)
    )
    share = batch.part(slice(1, None, 2), "cpu")
    torch.testing.assert_close(share.truth, batch.truth[1::2])
    torch.testing.assert_close(share.draws.noise, batch.draws.noise[:, 1::2])
    torch.testing.assert_close(share.draws.sigma, batch.draws.sigma[1::2])
    torch.testing.assert_close(batch.truth.sum((-2, -1)), RIGHT.sum().expand(6))
    assert len({tuple(one.nonzero()[0].tolist()) for one in batch.truth}) > 1
