"""Objective of each network, or part of one: its loss, and the measure of its progress."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import nn

from invert.network.despeckler import Despeckler
from invert.network.inference import predict
from invert.network.model import Denoiser, Fusion
from invert.network.sampler import Sampler
from invert.training.chains import Chains, chain_loss
from invert.training.data import Batch
from invert.training.denoising import Task, denoising_loss, make_denoising_task
from invert.training.losses import LOSSES, noise_left, registered_pearson
from invert.training.speckle import Speckled

CONFIDENCE_LOSS_WEIGHT = 0.5
"""Weight of the cross-entropy of the predicted correlation in the loss."""

VALIDATION_SIGMA = 0.7
"""Noise level at which the progress of the sampler is measured."""


class Stateless:
    """Objective without a state of its own."""

    def __init__(self) -> None:
        self.state: dict[str, torch.Tensor] = {}

    def restore(self, state: dict[str, torch.Tensor]) -> None:
        """Ignore the checkpoint, because there is no state."""


class DenoisedLags(Stateless):
    """Objective of the denoiser: the lowest remaining noise."""

    measure = "share of the noise left"

    def loss(self, module: nn.Module, batch: Batch, _: torch.Generator | None = None) -> torch.Tensor:
        measured = batch.seen.values - batch.seen.floor[:, None, None]
        return noise_left(predict(module, batch.seen), batch.signal, measured).mean()

    def measure_progress(self, module: nn.Module, batch: Batch) -> float:
        return float(self.loss(module, batch).exp())


class DespeckledIntensity(Stateless):
    """Objective of the despeckler: the lowest squared error relative to the energy of the albedo."""

    measure = "share of the albedo's energy missed"

    def loss(self, module: nn.Module, batch: Speckled, _: torch.Generator | None = None) -> torch.Tensor:
        return (self._relative_error(module, batch) + 1e-6).sqrt().mean()

    def measure_progress(self, module: nn.Module, batch: Speckled) -> float:
        return float(self._relative_error(module, batch).median())

    def _relative_error(self, module: nn.Module, batch: Speckled) -> torch.Tensor:
        """Return the squared error of each albedo over its energy, (n,)."""
        error = (module(batch.intensity, batch.looks) - batch.truth).square().sum((-2, -1))
        return error / batch.truth.square().sum((-2, -1)).clamp_min(1e-6)


class Picture(Stateless):
    """Objective of a network that reconstructs the object, up to shift and twin image; the fusion also predicts its
    correlation."""

    measure = "registered correlation"

    def __init__(self, loss: str, judged: bool) -> None:
        super().__init__()
        self._loss, self._judged = LOSSES[loss], judged

    def loss(self, module: nn.Module, batch: Batch, _: torch.Generator) -> torch.Tensor:
        output = predict(module, batch.seen)  # the sketch returns albedos alone
        albedo, judgement = output if isinstance(output, tuple) else (output, None)
        shown = batch.truth.amax((-2, -1)) > 0.0
        # Samples without signal have no loss; a substitute keeps their gradient finite.
        truth = torch.where(shown[:, None, None], batch.truth, 1.0 + albedo.detach())
        loss = (self._loss(albedo, truth) * shown).sum() / shown.sum().clamp_min(1)
        if not self._judged or judgement is None:
            return loss
        with torch.no_grad():
            achieved = registered_pearson(albedo, batch.truth).clamp(0.0, 1.0) * shown
        return loss + CONFIDENCE_LOSS_WEIGHT * nn.functional.binary_cross_entropy_with_logits(judgement, achieved)

    def measure_progress(self, module: nn.Module, batch: Batch) -> float:
        answer = predict(module, batch.seen)
        albedo = answer[0] if isinstance(answer, tuple) else answer
        shown = batch.truth.amax((-2, -1)) > 0.0
        return float(registered_pearson(albedo[shown], batch.truth[shown]).mean())


class DenoisedPicture:
    """Objective of the sampler: the expected albedo given a noisy image, at every noise level and in the middle of annealing."""

    measure = f"share of the albedo's energy missed behind noise of {VALIDATION_SIGMA}"

    def __init__(self) -> None:
        self._chains: dict[int, Chains] = {}

    @property
    def state(self) -> dict[str, torch.Tensor]:
        """Return the state of the chains of each side, for a checkpoint."""
        return {f"{side}.{name}": one for side, chains in self._chains.items() for name, one in chains.state.items()}

    def restore(self, state: dict[str, torch.Tensor]) -> None:
        """Continue with the chains of a checkpoint."""
        for key, one in state.items():
            side, _, name = key.partition(".")
            self._chains.setdefault(int(side), Chains(int(side))).state[name] = one

    def loss(self, module: nn.Module, batch: Batch, rng: torch.Generator) -> torch.Tensor:
        side = batch.truth.shape[-1]
        chains = self._chains.setdefault(side, Chains(side))
        device, count = batch.truth.device, min((len(batch.truth) + 1) // 2, chains.count)
        which = chains.draw(batch.part(slice(count), "cpu"), rng)
        chained, fresh = chains.task(which, device), self._task(module, batch.part(slice(count, None), device))
        answer = chained.join(fresh).answer(module)
        chains.follow(which, chained, answer[:count].detach(), rng)
        return torch.cat(
            (chain_loss(answer[:count], chained.truth), denoising_loss(answer[count:], fresh.truth, fresh.sigma))
        ).mean()

    def measure_progress(self, module: nn.Module, batch: Batch) -> float:
        level = torch.full_like(batch.seen.floor, VALIDATION_SIGMA)
        answer = self._task(module, replace(batch, draws=replace(batch.draws, sigma=level))).answer(module)
        return float((answer - batch.truth).square().sum() / batch.truth.square().sum())

    def _task(self, module: nn.Module, batch: Batch) -> Task:
        assert batch.draws is not None
        return make_denoising_task(module, batch.seen, batch.truth, batch.draws)


def objective(part: nn.Module, loss: str) -> DenoisedLags | DespeckledIntensity | Picture | DenoisedPicture:
    """Return the objective of a network or of a part of the default one.

    Args:
        loss: name in `LOSSES` of the loss of images.
    """
    if isinstance(part, Denoiser):
        return DenoisedLags()
    if isinstance(part, Despeckler):
        return DespeckledIntensity()
    return DenoisedPicture() if isinstance(part, Sampler) else Picture(loss, isinstance(part, Fusion))
