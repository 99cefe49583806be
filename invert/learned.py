"""The network at work: one look, and several looks at mirrored and turned estimates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import nn

from invert.features import Observation
from invert.spectrum import Measurement

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


def predict(network: nn.Module, seen: Observation) -> tuple[torch.Tensor, torch.Tensor]:
    """Albedos (n, 64, 64), and logits of the correlation with the truth that the network expects of each.

    bfloat16 inside, float32 outside.
    """
    with torch.autocast(seen.estimate.device.type, dtype=torch.bfloat16):
        return network(seen)


def observation(measurement: Measurement, classical: torch.Tensor | None = None) -> Observation:
    """What the network is shown of one measurement."""
    one = Observation.alone(torch.from_numpy(measurement.estimate)[None], torch.tensor([measurement.noise.floor]).float(),
                            torch.tensor([measurement.noise.dof or UNBOUNDED_DOF]).float())
    if classical is None:
        return one
    return replace(one, classical=classical[None])


@torch.no_grad()
def looks(network: nn.Module, seen: Observation, poses: int) -> tuple[torch.Tensor, float]:
    """Albedos (poses, 64, 64) from one observation in so many poses, each turned back, and the logit of the correlation it
    expects."""
    posed = Observation(torch.cat([pose(seen.estimate) for pose, _ in POSES[:poses]]), seen.floor.expand(poses),
                        seen.dof.expand(poses), torch.cat([pose(seen.classical) for pose, _ in POSES[:poses]]))
    albedo, expected = predict(network, posed)
    turned_back = torch.stack([back(one) for (_, back), one in zip(POSES, albedo, strict=False)])
    return turned_back, float(expected.mean())
