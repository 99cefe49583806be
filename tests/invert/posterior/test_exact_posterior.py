"""The last round of the annealing, for a toy whose posterior is known: at most six squares of twelve are bright.

The exact expectation of the toy's albedo behind noise takes the place of the network. Levels, kept noise and fresh noise are
tested alone, and with the data-consistency steps of the last round.
"""

from itertools import combinations

import pytest
import torch

from invert.likelihood.gamma import Likelihood
from invert.measure.spectrum import Measurement, read_measurement
from invert.network.annealing import Annealing, Chain, run_annealing
from invert.network.data_steps import end_at_deviance_of_truth, take_last_steps
from invert.network.features import Observation
from invert.network.inference import make_observation
from invert.training.data import at_noise

ROWS, COLUMNS, MOST = 3, 4, 6
BATCH = 100
"""Number of samples drawn together; a thousand take longer, for memory."""
TRUTH = (0, 1, 6, 8)


def toy(bright: tuple[int, ...]) -> torch.Tensor:
    """Squares of 3 x 3 lags on a grid of 5 by 7; (64, 64)."""
    image = torch.zeros(64, 64)
    for square in bright:
        row, column = 22 + 5 * (square // COLUMNS), 18 + 7 * (square % COLUMNS)
        image[row : row + 3, column : column + 3] = 1.0
    return image


ALL = torch.stack([toy(bright) for count in range(1, MOST + 1) for bright in combinations(range(ROWS * COLUMNS), count)])
_NEAR = (..., slice(20, 38), slice(16, 44))
"""Lags that hold every toy."""
_TOYS = ALL[_NEAR].flatten(1)


class ExactExpectation:
    """E[albedo | noisy picture, estimate] over all toys."""

    def __init__(self, measurement: Measurement) -> None:
        self.log_posterior = Likelihood.of(measurement)(ALL).float().log_softmax(0)

    def __call__(self, seen: Observation, noisy: torch.Tensor, sigma: torch.Tensor, guess: torch.Tensor) -> torch.Tensor:
        overlap = noisy[_NEAR].flatten(1) @ _TOYS.T - 0.5 * _TOYS.square().sum(1)
        weight = (self.log_posterior + overlap / sigma.square()[:, None]).softmax(1)
        expected = torch.zeros_like(noisy)
        expected[_NEAR] = (weight @ _TOYS).unflatten(1, expected[_NEAR].shape[1:])
        return expected


def stay(data: Observation, denoised: torch.Tensor, sigma: torch.Tensor, steps: int) -> torch.Tensor:
    """Take no data-consistency step."""
    return denoised


@pytest.mark.slow
@pytest.mark.parametrize(
    ("floor", "dof", "data_step", "samples"),
    [(3.0, 64.0, stay, 2000), (2.0, 64.0, stay, 2000), (1.0, 16.0, stay, 2000), (2.0, 64.0, take_last_steps, 1000)],
)
def test_samples_have_the_posteriors_probabilities(floor, dof, data_step, samples):
    """Total variation distance below 0.1, of which counting samples makes up to 0.04; four or more objects are likely.

    What is expected on the way has the posterior's mean, too, and the mean of twenty of it less noise.
    """
    estimate = at_noise(toy(TRUTH)[None], floor, dof, torch.Generator().manual_seed(7)).seen.values[0]
    measurement = read_measurement(estimate.numpy())
    exact = ExactExpectation(measurement)
    assert samples % BATCH == 0
    options = Annealing(BATCH, rounds=1, steps=24, first=16.0)
    chain = Chain(exact, make_observation([measurement]), 1.0, torch.Generator().manual_seed(8))
    batches = [run_annealing(chain, torch.zeros(BATCH, 64, 64), options, data_step) for _ in range(samples // BATCH)]
    found, expected = (torch.cat([one[_NEAR].flatten(1) for one in parts]) for parts in zip(*batches, strict=True))
    nearest = torch.cdist(found, _TOYS).argmin(1)
    sampled = torch.bincount(nearest, minlength=len(ALL)) / samples
    posterior = exact.log_posterior.exp()
    assert float(0.5 * (sampled - posterior).abs().sum()) < 0.1
    assert float(1.0 / posterior.square().sum()) > 4.0
    mean = posterior @ _TOYS
    torch.testing.assert_close(expected.mean(0), mean, atol=0.02, rtol=0.0)
    by_samples, by_expected = (
        float((one.unflatten(0, (-1, 20)).mean(1) - mean).square().sum(1).mean()) for one in (found, expected)
    )
    assert by_expected < 0.9 * by_samples


@pytest.mark.slow
def test_the_last_steps_change_no_object():
    """Samples reach lower deviances, in noise of twice the peak as far as the prior permits, and show the same objects."""
    estimate = at_noise(toy(TRUTH)[None], 2.0, 64.0, torch.Generator().manual_seed(7)).seen.values[0]
    measurement = read_measurement(estimate.numpy())
    chain = Chain(ExactExpectation(measurement), make_observation([measurement]), 1.0, torch.Generator().manual_seed(8))
    found, _ = run_annealing(chain, torch.zeros(200, 64, 64), Annealing(200, rounds=1, steps=24, first=16.0), stay)
    normal = torch.randn(200, generator=torch.Generator().manual_seed(1))
    moved = end_at_deviance_of_truth(chain.data, found, torch.full((200,), 0.05), 1.0, normal)
    before, after = (torch.cdist(one[_NEAR].flatten(1), _TOYS).argmin(1) for one in (found, moved))
    assert float((before != after).double().mean()) < 0.02
    begun, ended = (chain.data.likelihood().at(one).deviance() for one in (found, moved))
    assert bool((ended <= begun + 1e-6).all())
    assert float(begun.std()) < 0.1 * float(ended.std())
