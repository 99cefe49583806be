"""The network at work: one look, and several looks at mirrored and turned estimates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import nn

from invert.features import Observation
from invert.spectrum import Measurement
from invert.unet import CorrelographyNet

Pose = Callable[[torch.Tensor], torch.Tensor]

POSES: tuple[tuple[Pose, Pose], ...] = (
    (lambda x: x, lambda x: x),
    (lambda x: x.flip(-1), lambda x: x.flip(-1)),
    (lambda x: x.mT, lambda x: x.mT),
    (lambda x: torch.rot90(x, 1, (-2, -1)), lambda x: torch.rot90(x, -1, (-2, -1))),
)
"""Mirrors and quarter turns, each with its inverse. The half turn is left out: it maps an autocorrelation onto itself."""

UNBOUNDED_DOF = 1e6
"""K of an estimate without measurable noise."""


def predict(network: nn.Module, seen: Observation) -> Any:
    """What a network, or one part of it, makes of observations; bfloat16 inside, float32 outside.

    Networks that draw give albedos (n, 64, 64), and logits of the correlation with the truth that they expect of each.
    """
    with torch.autocast(seen.estimate.device.type, dtype=torch.bfloat16):
        return network(seen)


@torch.no_grad()
def denoise(network: CorrelographyNet, seen: Observation, poses: int) -> torch.Tensor:
    """Signals (n, 127, 127) of observations without floor and noise, on their device: the mean over so many poses."""
    turned_back = []
    for pose, back in POSES[:poses]:
        posed = Observation.bare(pose(seen.estimate), seen.floor, seen.dof)
        turned_back.append(back(predict(network.denoiser, posed)))
    return torch.stack(turned_back).mean(0)


def observation(measurements: Sequence[Measurement]) -> Observation:
    """What a network is shown of measurements."""
    return Observation.bare(torch.from_numpy(np.stack([one.estimate for one in measurements])),
                            torch.tensor([one.noise.floor for one in measurements], dtype=torch.float32),
                            torch.tensor([one.noise.dof or UNBOUNDED_DOF for one in measurements], dtype=torch.float32))


@torch.no_grad()
def looks(network: nn.Module, seen: Observation, poses: int) -> tuple[torch.Tensor, float]:
    """Albedos (poses, 64, 64) from one observation in so many poses, each turned back, and the logit of the correlation it
    expects."""
    estimate, denoised, classical = (torch.cat([pose(picture) for pose, _ in POSES[:poses]])
                                     for picture in (seen.estimate, seen.denoised, seen.classical))
    posed = Observation(estimate, seen.floor.expand(poses), seen.dof.expand(poses), denoised, classical)
    albedo, expected = predict(network, posed)
    turned_back = torch.stack([back(one) for (_, back), one in zip(POSES, albedo, strict=False)])
    return turned_back, float(expected.mean())
