"""What each network, or part of one, is trained for: its loss, and the measure of its progress."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import nn

from invert.network.inference import predict
from invert.network.model import Denoiser, Fusion
from invert.network.sampler import Sampler
from invert.training.data import Batch
from invert.training.denoising import Draws, denoising_loss, guessed
from invert.training.losses import LOSSES, noise_left, registered_pearson

JUDGE_WEIGHT = 0.5

MEASURED_AT = 0.7
"""Noise level at which the sampler's progress is measured."""


class DenoisedLags:
    """The denoiser's: as little noise as possible."""

    measure = "share of the noise left"

    def loss(self, module: nn.Module, batch: Batch) -> torch.Tensor:
        measured = batch.seen.estimate - batch.seen.floor[:, None, None]
        return noise_left(predict(module, batch.seen), batch.signal, measured).mean()

    def achieved(self, module: nn.Module, batch: Batch) -> float:
        return float(self.loss(module, batch).exp())


class Picture:
    """Of a network that draws the object, anywhere and either way round; the fusion also says how well."""

    measure = "registered correlation"

    def __init__(self, loss: str, judged: bool) -> None:
        self._loss, self._judged = LOSSES[loss], judged

    def loss(self, module: nn.Module, batch: Batch) -> torch.Tensor:
        albedo, judgement = predict(module, batch.seen) if self._judged else (predict(module, batch.seen), None)
        shown = batch.truth.amax((-2, -1)) > 0.0
        # Samples of noise alone have no loss; a stand-in keeps their gradient finite.
        truth = torch.where(shown[:, None, None], batch.truth, 1.0 + albedo.detach())
        loss = (self._loss(albedo, truth) * shown).sum() / shown.sum().clamp_min(1)
        if judgement is None:
            return loss
        with torch.no_grad():
            achieved = registered_pearson(albedo, batch.truth).clamp(0.0, 1.0) * shown
        return loss + JUDGE_WEIGHT * nn.functional.binary_cross_entropy_with_logits(judgement, achieved)

    def achieved(self, module: nn.Module, batch: Batch) -> float:
        answer = predict(module, batch.seen)
        albedo = answer[0] if self._judged else answer
        shown = batch.truth.amax((-2, -1)) > 0.0
        return float(registered_pearson(albedo[shown], batch.truth[shown]).mean())


class DenoisedPicture:
    """The sampler's: the expected albedo behind noise of every level."""

    measure = f"share of the albedo's energy missed behind noise of {MEASURED_AT}"

    def loss(self, module: nn.Module, batch: Batch) -> torch.Tensor:
        answer, draws = self._answer(module, batch)
        return denoising_loss(answer, batch.truth, draws.sigma).mean()

    def achieved(self, module: nn.Module, batch: Batch) -> float:
        level = torch.full_like(batch.seen.floor, MEASURED_AT)
        answer, _ = self._answer(module, replace(batch, draws=replace(batch.draws, sigma=level)))
        return float((answer - batch.truth).square().sum() / batch.truth.square().sum())

    def _answer(self, module: nn.Module, batch: Batch) -> tuple[torch.Tensor, Draws]:
        draws = batch.draws
        assert draws is not None
        noisy = batch.truth + draws.sigma[:, None, None] * draws.noise[0]
        return module(batch.seen, noisy, draws.sigma, guessed(module, batch.seen, batch.truth, draws)), draws


def objective(part: nn.Module, loss: str) -> DenoisedLags | Picture | DenoisedPicture:
    """That of a network or of a part of the default one.

    Args:
        loss: of pictures, a name in `LOSSES`.
    """
    if isinstance(part, Denoiser):
        return DenoisedLags()
    return DenoisedPicture() if isinstance(part, Sampler) else Picture(loss, isinstance(part, Fusion))
