"""From a measurement to a reconstruction: denoise, retrieve, fuse, draw samples, average."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import nn

from invert.albedo.registration import Consensus, centred, consensus, normalised, padded, registered
from invert.measure.spectrum import Measurement, denoised_modulus, fourier_modulus
from invert.network.annealing import ANNEALING, posterior_samples
from invert.network.confidence import ConfidenceFeatures, with_one_more
from invert.network.features import Observation
from invert.network.model import CorrelographyNet
from invert.network.retrieval_summary import overview
from invert.solvers.base import Candidates, Progress
from invert.solvers.hio import HioOptions, hio

Transform = Callable[[torch.Tensor], torch.Tensor]

AUGMENTATIONS: tuple[tuple[Transform, Transform], ...] = (
    (lambda x: x, lambda x: x),
    (lambda x: x.flip(-1), lambda x: x.flip(-1)),
    (lambda x: x.mT, lambda x: x.mT),
    (lambda x: torch.rot90(x, 1, (-2, -1)), lambda x: torch.rot90(x, -1, (-2, -1))),
)
"""Test-time augmentation: mirrors and quarter turns, each with its inverse. A rotation by 180 degrees maps an autocorrelation
onto itself and is left out."""

RETRIEVAL = HioOptions(iterations=300, error_reduction=50, shrink_from=100, shrink_every=30,
                       shrink_threshold=(0.03, 0.06, 0.1, 0.18))
"""The retrieval that the network fuses. A low threshold of shrink-wrap keeps faint structure, a high one keeps noise out of the
support."""

STARTS = {"fast": 6, "balanced": 16, "best": 32}
"""Of the retrieval from the estimate, and as many from its denoised signal. In bright light samples take the places of the
likeliest: with 16, edges one pixel wide gain .04 in correlation at K 256, .02 at K 10000, over none."""

AUGMENTED = {"fast": 1, "balanced": len(AUGMENTATIONS), "best": len(AUGMENTATIONS)}
"""Augmentations of an estimate."""

EXPECTED = 0.7
"""Share in the answer of what the sampler expected on the way to its samples: their own mean follows the data closer, and has
more noise. Two rendered frames of six letters gain .02 in correlation at 1/256 s and .01 at 1/512 s over samples alone; edges
one pixel wide neither gain nor lose."""

UNBOUNDED_DOF = 1e6
"""K of an estimate without measurable noise."""


@dataclass(frozen=True)
class NetworkAnswer:
    """A network's reconstruction.

    Attributes:
        image: (128, 128), periodic.
        transfer: phase retrieval transfer function of the samples or augmentations, empty where there was one.
        samples: of the posterior (n, 64, 64), equally likely; None where none were drawn.
    """

    image: torch.Tensor
    features: ConfidenceFeatures
    transfer: tuple[float, ...]
    samples: torch.Tensor | None = None


def predict(network: nn.Module, seen: Observation) -> Any:
    """Output of a network, or of one part of it, for observations; bfloat16 inside, float32 outside.

    Networks that reconstruct give albedos (n, 64, 64), and logits of the correlation with the truth that they expect of each.
    """
    with torch.autocast(seen.estimate.device.type, dtype=torch.bfloat16):
        return network(seen)


def observation(measurements: Sequence[Measurement]) -> Observation:
    """Network input from measurements."""
    return Observation.bare(torch.from_numpy(np.stack([one.estimate for one in measurements])),
                            torch.tensor([one.noise.floor for one in measurements], dtype=torch.float32),
                            torch.tensor([one.noise.dof or UNBOUNDED_DOF for one in measurements], dtype=torch.float32))


@torch.no_grad()
def denoise(network: CorrelographyNet, seen: Observation, augmented: int) -> torch.Tensor:
    """Signals (n, 127, 127) of observations without floor and noise: the mean over `augmented` augmentations."""
    denoised = []
    for transform, inverse in AUGMENTATIONS[:augmented]:
        transformed = Observation.bare(transform(seen.estimate), seen.floor, seen.dof)
        denoised.append(inverse(predict(network.denoiser, transformed)))
    return torch.stack(denoised).mean(0)


def retrieved(measurement: Measurement, denoised: torch.Tensor, starts: int, seed: int, device: str,
              progress: Progress = lambda: None) -> Candidates:
    """Classical retrieval from an estimate and from its denoised signal (127, 127), which has less noise but less fine
    structure, too: images (2, starts, 128, 128)."""
    moduli = torch.stack((fourier_modulus(measurement), denoised_modulus(denoised.cpu().numpy(), measurement)))
    rng = torch.Generator(device=device).manual_seed(seed)
    return hio(moduli.to(device), measurement.box, rng, replace(RETRIEVAL, starts=starts), progress)


@torch.no_grad()
def fuse(network: nn.Module, seen: Observation, shown: torch.Tensor, augmented: int) -> tuple[torch.Tensor, torch.Tensor]:
    """What the network makes of one observation beside each of n sets of classical reconstructions (n, PICTURES, 64, 64).

    The augmentations take turns, each undone in its albedo. Returns albedos (n, 64, 64) and logits (n,) of the correlations
    that the network expects.
    """
    pairs = [AUGMENTATIONS[index % augmented] for index in range(len(shown))]
    estimate, denoised = (torch.cat([transform(one) for transform, _ in pairs]) for one in (seen.estimate, seen.denoised))
    classical = torch.stack([transform(images) for (transform, _), images in zip(pairs, shown, strict=True)])
    transformed = Observation(estimate, seen.floor.expand(len(shown)), seen.dof.expand(len(shown)), denoised, classical)
    albedo, expected = predict(network, transformed)
    return torch.stack([inverse(one) for (_, inverse), one in zip(pairs, albedo, strict=True)]), expected


def reconstruct_by_network(network: nn.Module, measurement: Measurement, quality: str, seed: int, device: str,
                           progress: Progress = lambda: None) -> NetworkAnswer:
    """The posterior's mean. Where no samples are drawn (`fast`, the paper's networks) what the network makes of the estimate,
    the mean over its augmentations."""
    augmented = AUGMENTED[quality]
    seen = observation([measurement]).part(slice(None), device)
    shown, agreement, found, samples = seen.classical, [0.0, 0.0], None, None
    if isinstance(network, CorrelographyNet):
        seen = replace(seen, denoised=denoise(network, seen, augmented))
        found = retrieved(measurement, seen.denoised[0], STARTS[quality], seed, device, progress)
        together, agreement = overview(found)
        shown = together[None]
    albedos, expected = fuse(network, seen, shown.expand(augmented, -1, -1, -1), augmented)
    if found is not None and quality in ANNEALING:
        candidates = torch.cat((albedos, _in_windows(found)))
        drawn = posterior_samples(network.sampler, seen, measurement.noise.inflation, candidates, ANNEALING[quality],
                                  torch.Generator().manual_seed(seed))
        samples, together = drawn.samples, _mean(drawn.samples, 0.0)
        image = _with_expected(together.image, drawn.expected)
    else:
        together = _mean(albedos, 0.7)
        image = together.image
    averaged = albedos if samples is None else samples
    features = ConfidenceFeatures(float(expected.mean()), with_one_more(together.agreement, len(averaged)), *agreement)
    return NetworkAnswer(image, features, together.transfer if len(averaged) > 1 else (), samples)


def _in_windows(found: Candidates) -> torch.Tensor:
    """Every start of a retrieval as an albedo (n, 64, 64), largest value 1."""
    return normalised(torch.stack([centred(one) for one in found.images.flatten(0, 1)]))


def _with_expected(samples: torch.Tensor, expected: torch.Tensor) -> torch.Tensor:
    """Mean of samples (128, 128), and `EXPECTED` of the mean of albedos (n, 64, 64) laid over it; largest values 1."""
    placed, _ = registered(padded(normalised(expected)), samples)
    return (1.0 - EXPECTED) * normalised(samples) + EXPECTED * normalised(placed.mean(0))


def _mean(albedos: torch.Tensor, alike: float) -> Consensus:
    """Registered mean of albedos (n, 64, 64) that are alike, see `consensus`."""
    return consensus(padded(normalised(albedos)), torch.arange(len(albedos)), len(albedos), alike)
