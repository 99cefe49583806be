"""Chains of annealing that the sampler is trained on: their levels, their lives, and what they are compared with."""

import pytest
import torch

from invert.training.chains import CHAINS, FIRST, FIRST_STEPS, ROUNDS, SCHEDULE, Chains, chain_loss
from invert.training.data import at_noise
from invert.training.denoising import MAX_SIGMA
from tests.invert.posterior.steps import RIGHT

SIX = SCHEDULE.steps


def all_drawn(chains: Chains, count: int = 4) -> torch.Tensor:
    """The numbers of as many chains as there are."""
    batch = at_noise(RIGHT.expand(count, -1, -1), 0.3, 64.0, torch.Generator().manual_seed(1))
    return chains.draw(batch, torch.Generator().manual_seed(2))


def test_a_chain_runs_through_its_rounds_and_makes_way():
    """First from noise alone, then from less; each round down to the last level; then another object takes its place."""
    chains, rng = Chains(), torch.Generator().manual_seed(3)
    which = all_drawn(chains)
    assert len(set(which.tolist())) == 4
    assert int((chains.state["left"] > 0).sum()) == 4
    rounds = chains.state["left"][which].clone()
    assert 1 <= int(rounds.min()) <= int(rounds.max()) <= ROUNDS
    levels = []
    for _ in range(FIRST_STEPS + (ROUNDS - 1) * SIX):
        task = chains.task(which, torch.device("cpu"))
        levels.append(task.sigma)
        chains.follow(which, task, task.truth, rng)
    told = torch.stack(levels)
    assert torch.equal(told[0], torch.full((4,), MAX_SIGMA))
    last = torch.full((4,), SCHEDULE.last)
    torch.testing.assert_close(told[FIRST_STEPS - 1], last)
    torch.testing.assert_close(told[FIRST_STEPS + SIX - 1], last)
    assert bool((told[1:FIRST_STEPS] < told[: FIRST_STEPS - 1]).all())
    assert bool(((told[FIRST_STEPS] >= FIRST[0]) & (told[FIRST_STEPS] <= FIRST[1])).all())
    assert bool((chains.state["left"][which] <= 0).all())


def test_a_chain_that_follows_the_truth_arrives_there():
    """Steps towards the data leave the truth nearly where it is, and the noisy picture comes down to it."""
    chains, rng = Chains(), torch.Generator().manual_seed(4)
    which = all_drawn(chains)
    for _ in range(FIRST_STEPS):
        task = chains.task(which, torch.device("cpu"))
        chains.follow(which, task, task.truth, rng)
    missed = (chains.state["albedo"][which] - RIGHT).square().sum((-2, -1)) / RIGHT.square().sum()
    assert float(missed.max()) < 0.1


def test_those_that_go_on_keep_their_objects():
    chains = Chains()
    all_drawn(chains, CHAINS)
    before = chains.state["noisy"].clone()
    batch = at_noise(RIGHT.mT[None].expand(CHAINS, -1, -1), 0.3, 64.0, torch.Generator().manual_seed(1))
    chains.state["left"][7] = 0.0
    chains.draw(batch, torch.Generator().manual_seed(5))
    torch.testing.assert_close(chains.state["truth"][7], RIGHT.mT)
    torch.testing.assert_close(chains.state["truth"][:7], RIGHT.expand(7, -1, -1))
    assert torch.equal(chains.state["noisy"][8:], before[8:])


@pytest.mark.parametrize("turned", [False, True])
def test_an_answer_may_stand_anywhere_and_either_way(turned):
    """Its loss is that of the truth laid over it."""
    answer = (RIGHT.flip((0, 1)) if turned else RIGHT).roll((3, -2), (0, 1))[None]
    assert float(chain_loss(answer, RIGHT[None])[0]) < 1e-6
    assert float(chain_loss(answer.flip(-1), RIGHT[None])[0]) > 0.05
