"""Training of the sampler on its own trajectories: partly denoised samples, with the errors that occur during annealing.

Noised truths, the other training task, never show the sampler its own errors (S. Ross et al., AISTATS 2011, arXiv:1011.0686).
"""

from __future__ import annotations

import math

import torch

from correlograph.lags import OBJECT_SIDE
from invert.albedo.registration import register_groups
from invert.choices import BALANCED
from invert.likelihood.data_consistency import MAX_ALBEDO
from invert.network.annealing import Annealing, noise_level_at, renoise
from invert.network.data_steps import take_shrunken_steps
from invert.network.features import Observation
from invert.network.sampler import ALBEDO_STD
from invert.training.data import Batch
from invert.training.denoising import MAX_SIGMA, Task, scale_dof_for_sums

SCHEDULE = Annealing.of(BALANCED)
"""Schedule of the annealing that the chains follow."""

CHAINS = 128
"""Number of chains of objects of 64 x 64 lags, and fewer of larger ones; each training step advances some of them by one step."""

FIRST_STEPS = 12
"""Steps of the first round of a chain, which starts with pure noise."""

ROUNDS = 5
"""Maximum number of rounds of a chain."""

FIRST = (0.4, 1.6)
"""Range of the initial noise level of all later rounds."""

WEIGHT = 0.3
"""Weight in the loss of a chain's squared error in units of the variance of albedos."""


class Chains:
    """Unfinished sampling of some objects, kept between the steps of a training.

    The sampler is trained on images that it meets when it samples. One chain samples one object in several rounds. Each round adds
    noise to the albedo, and lowers it in several steps.

    Attributes:
        count: number of chains.
        state: arrays with one entry for each chain: `estimate`, `floor`, `dof` and `truth` of its object; `noisy` image and `albedo`
            after the last step; `first`, the noise at the start of the round; `steps` of the round and how many are `done`; `left`,
            the remaining rounds including this one.
    """

    def __init__(self, side: int = OBJECT_SIDE) -> None:
        self.count = max(2, CHAINS * OBJECT_SIDE**2 // side**2)
        lags, pictures = (self.count, 2 * side - 1, 2 * side - 1), (self.count, side, side)
        shapes = {
            "estimate": lags,
            "floor": (self.count,),
            "dof": (self.count,),
            "truth": pictures,
            "noisy": pictures,
            "albedo": pictures,
            "first": (self.count,),
            "steps": (self.count,),
            "done": (self.count,),
            "left": (self.count,),
        }
        self.state = {name: torch.zeros(shape) for name, shape in shapes.items()}

    def draw(self, batch: Batch, rng: torch.Generator) -> torch.Tensor:
        """Select random chains, one per object of a batch, and return their indices; restart finished ones with these objects."""
        seen, truth = batch.seen, batch.truth
        which = torch.randperm(self.count, generator=rng)[: len(truth)]
        ended = self.state["left"][which] == 0
        rounds = torch.randint(1, ROUNDS + 1, (len(truth),), generator=rng)
        begun = {
            "estimate": seen.values,
            "floor": seen.floor,
            "dof": seen.dof,
            "truth": truth,
            "noisy": MAX_SIGMA * torch.randn(truth.shape, generator=rng),
            "albedo": torch.zeros_like(truth),
            "first": torch.full((len(truth),), MAX_SIGMA),
            "steps": torch.full((len(truth),), float(FIRST_STEPS)),
            "done": torch.zeros(len(truth)),
            "left": rounds.float(),
        }
        for name, value in begun.items():
            self.state[name][which[ended]] = value[ended]
        return which

    def task(self, which: torch.Tensor, device: torch.device) -> Task:
        """Return input and target of the next annealing step of some chains; a chain is a sample on its way from noise to an
        object.
        """
        one = {name: value[which].to(device) for name, value in self.state.items()}
        seen = Observation.from_estimate(one["estimate"], one["floor"], one["dof"])
        return Task(seen, one["truth"], one["noisy"], _level(one, one["done"]), one["albedo"])

    def follow(self, which: torch.Tensor, task: Task, answer: torch.Tensor, rng: torch.Generator) -> None:
        """Advance chains by the denoiser output, as annealing does."""
        one = {name: value[which] for name, value in self.state.items()}
        data = scale_dof_for_sums(task.seen)
        expected = answer.clamp(0.0, MAX_ALBEDO)
        albedo = take_shrunken_steps(data, expected, task.sigma, SCHEDULE.ascent).cpu()
        noise = torch.randn(albedo.shape, generator=rng)
        done = one["done"] + 1.0
        low, high = map(math.log, FIRST)
        first = (low + (high - low) * torch.rand(len(which), generator=rng)).exp()
        ends = done >= one["steps"]
        level, following = _level(one, one["done"]), _level(one, done)
        noisy = renoise(albedo, one["noisy"], level[:, None, None], following[:, None, None], noise)
        self.state["noisy"][which] = torch.where(ends[:, None, None], albedo + first[:, None, None] * noise, noisy)
        self.state["albedo"][which] = albedo
        self.state["done"][which] = torch.where(ends, 0.0, done)
        self.state["left"][which] = one["left"] - ends.float()
        self.state["first"][which] = torch.where(ends, first, one["first"])
        self.state["steps"][which] = torch.where(ends, float(SCHEDULE.steps), one["steps"])


def _level(one: dict[str, torch.Tensor], done: torch.Tensor) -> torch.Tensor:
    """Return the noise level of a round's step, (n,)."""
    share = (done / (one["steps"] - 1.0)).clamp(0.0, 1.0)
    return noise_level_at(share, one["first"], SCHEDULE.last)


def chain_loss(answer: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Return the squared error in units of the variance of albedos, (n,), against the registered truth, because chains
    choose shift and twin image freely."""
    fitting = register_groups(truth[:, None], answer.detach())[:, 0]
    return WEIGHT * (answer - fitting).square().mean((-2, -1)) / ALBEDO_STD**2
