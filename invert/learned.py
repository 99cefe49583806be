"""The network at work: denoise the estimate, retrieve from it, draw every proposal, keep the likeliest drawings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import nn

from invert.features import Observation
from invert.hio import HioOptions, hio
from invert.likelihood import log_likelihoods
from invert.projections import Candidates, Progress
from invert.proposals import overview, proposals
from invert.registration import OBJECT, consensus
from invert.spectrum import Measurement, denoised_modulus, fourier_modulus
from invert.unet import CorrelographyNet

Pose = Callable[[torch.Tensor], torch.Tensor]

POSES: tuple[tuple[Pose, Pose], ...] = (
    (lambda x: x, lambda x: x),
    (lambda x: x.flip(-1), lambda x: x.flip(-1)),
    (lambda x: x.mT, lambda x: x.mT),
    (lambda x: torch.rot90(x, 1, (-2, -1)), lambda x: torch.rot90(x, -1, (-2, -1))),
)
"""Mirrors and quarter turns, each with its inverse. The half turn is left out: it maps an autocorrelation onto itself."""

RETRIEVAL = {"fast": (4, 600), "balanced": (32, 1000), "best": (128, 1000)}
"""Starts and iterations of the retrieval that proposes what the network draws."""

SHRINK_THRESHOLDS = (0.03, 0.06, 0.1, 0.18)
"""Faint structure survives a low threshold, and a high one keeps noise from leading the support astray: the likelihood of what
comes of either tells which was right."""

LOOKS = {"fast": 1, "balanced": len(POSES), "best": len(POSES)}
"""Poses in which the network looks at an estimate; with one it draws all starts together, with more each by itself, too."""

KEPT = 8
"""Drawings, the likeliest, of which the mean is taken."""

UNBOUNDED_DOF = 1e6
"""K of an estimate without measurable noise."""


@dataclass(frozen=True)
class Drawing:
    """A network's picture (128, 128), periodic, and signs of how good it is: the logit of the correlation that it expects, the
    agreement of its drawings, that of the classical starts with and without noise; the drawings' transfer function."""

    image: torch.Tensor
    signs: tuple[float, ...]
    transfer: tuple[float, ...]


def predict(network: nn.Module, seen: Observation) -> Any:
    """What a network, or one part of it, makes of observations; bfloat16 inside, float32 outside.

    Networks that draw give albedos (n, 64, 64), and logits of the correlation with the truth that they expect of each.
    """
    with torch.autocast(seen.estimate.device.type, dtype=torch.bfloat16):
        return network(seen)


def observation(measurements: Sequence[Measurement]) -> Observation:
    """What a network is shown of measurements."""
    return Observation.bare(torch.from_numpy(np.stack([one.estimate for one in measurements])),
                            torch.tensor([one.noise.floor for one in measurements], dtype=torch.float32),
                            torch.tensor([one.noise.dof or UNBOUNDED_DOF for one in measurements], dtype=torch.float32))


@torch.no_grad()
def denoise(network: CorrelographyNet, seen: Observation, poses: int) -> torch.Tensor:
    """Signals (n, 127, 127) of observations without floor and noise, on their device: the mean over so many poses."""
    turned_back = []
    for pose, back in POSES[:poses]:
        posed = Observation.bare(pose(seen.estimate), seen.floor, seen.dof)
        turned_back.append(back(predict(network.denoiser, posed)))
    return torch.stack(turned_back).mean(0)


def retrieval_options(quality: str) -> HioOptions:
    """Of the classical retrieval that the network is shown."""
    starts, iterations = RETRIEVAL[quality]
    return HioOptions(starts=starts, iterations=iterations, shrink_threshold=SHRINK_THRESHOLDS)


def retrieved(measurement: Measurement, denoised: torch.Tensor, quality: str, seed: int, device: str,
              progress: Progress = lambda: None) -> Candidates:
    """Classical retrieval from an estimate and from its denoised signal (127, 127), whose noise is less but whose fine
    structure is, too: images (2, starts, 128, 128)."""
    moduli = torch.stack((fourier_modulus(measurement), denoised_modulus(denoised.cpu().numpy(), measurement)))
    generator = torch.Generator(device=device).manual_seed(seed)
    return hio(moduli.to(device), measurement.box, generator, retrieval_options(quality), progress)


@torch.no_grad()
def look(network: nn.Module, seen: Observation, shown: torch.Tensor, poses: int) -> tuple[torch.Tensor, torch.Tensor]:
    """What the network draws of one observation beside each of n sets of classical pictures (n, PICTURES, 64, 64).

    The poses take turns; every drawing is turned back. Returns albedos (n, 64, 64) and the logits (n,) of the correlations it
    expects.
    """
    turns = [POSES[index % poses] for index in range(len(shown))]
    estimate, denoised = (torch.cat([pose(picture) for pose, _ in turns]) for picture in (seen.estimate, seen.denoised))
    classical = torch.stack([pose(pictures) for (pose, _), pictures in zip(turns, shown, strict=True)])
    posed = Observation(estimate, seen.floor.expand(len(shown)), seen.dof.expand(len(shown)), denoised, classical)
    albedo, expected = predict(network, posed)
    return torch.stack([back(one) for (_, back), one in zip(turns, albedo, strict=True)]), expected


def draw(network: nn.Module, measurement: Measurement, quality: str, seed: int, device: str,
         progress: Progress = lambda: None) -> Drawing:
    """Draw what all starts show together, in every pose, and what each start shows; the mean of the likeliest drawings."""
    poses = LOOKS[quality]
    seen = observation([measurement]).part(slice(None), device)
    shown, agreement = seen.classical.expand(poses, -1, -1, -1), [0.0, 0.0]
    if isinstance(network, CorrelographyNet):
        seen = replace(seen, denoised=denoise(network, seen, poses))
        found = retrieved(measurement, seen.denoised[0], quality, seed, device, progress)
        together, agreement = overview(found)
        shown = together.expand(poses, -1, -1, -1)
        if poses > 1:
            shown = torch.cat((shown, proposals(found, len(SHRINK_THRESHOLDS))))
    albedos, expected = look(network, seen, shown, poses)
    kept = log_likelihoods(albedos, measurement).argsort(descending=True, stable=True)[:KEPT]
    drawings = torch.nn.functional.pad(albedos[kept], (0, OBJECT, 0, OBJECT))
    mean = consensus(drawings / drawings.amax((-2, -1), keepdim=True).clamp_min(1e-30), torch.arange(len(kept)))
    return Drawing(mean.image, (float(expected[kept].mean()), mean.agreement, *agreement),
                   mean.transfer if len(kept) > 1 else ())
