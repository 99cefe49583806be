"""The network at work: one look, and several looks at mirrored and turned estimates."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import nn

from invert.features import features, paper_picture
from invert.spectrum import Measurement
from invert.unet import PaperUnet

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


def predict(network: nn.Module, estimate: torch.Tensor, floor: torch.Tensor,
            dof: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Albedos (n, 64, 64) of estimates (n, 127, 127), and logits of the correlation with the truth that the network expects."""
    plain = network.module if isinstance(network, nn.parallel.DistributedDataParallel) else network
    seen = paper_picture(estimate) if isinstance(plain, PaperUnet) else features(estimate, floor, dof)
    with torch.autocast(estimate.device.type, dtype=torch.bfloat16):
        return network(seen.to(memory_format=torch.channels_last))


@torch.no_grad()
def looks(network: nn.Module, measurement: Measurement, poses: int, device: str) -> tuple[torch.Tensor, float]:
    """Albedos (poses, 64, 64) from the estimate in so many poses, each turned back, and the correlation expected of one."""
    estimate = torch.from_numpy(measurement.estimate).to(device)
    posed = torch.stack([pose(estimate) for pose, _ in POSES[:poses]])
    floor = torch.full((poses,), measurement.noise.floor, device=device)
    dof = torch.full((poses,), measurement.noise.dof or UNBOUNDED_DOF, device=device)
    albedo, expected = predict(network, posed, floor, dof)
    turned_back = torch.stack([back(one) for (_, back), one in zip(POSES, albedo, strict=False)])
    return turned_back, float(expected.sigmoid().mean())
