"""From a measurement to a reconstruction: denoise, retrieve, fuse every proposal into a candidate, draw samples from the
likeliest, average."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import nn

from invert.likelihood import log_likelihoods
from invert.network.annealing import ANNEALING, posterior_samples
from invert.network.confidence import ConfidenceFeatures, with_one_more
from invert.network.features import Observation
from invert.network.model import CorrelographyNet
from invert.network.proposals import overview, proposals
from invert.registration import Consensus, consensus, normalised, padded, registered
from invert.solvers.base import Candidates, Progress
from invert.solvers.hio import HioOptions, hio
from invert.spectrum import Measurement, denoised_modulus, fourier_modulus

Transform = Callable[[torch.Tensor], torch.Tensor]

AUGMENTATIONS: tuple[tuple[Transform, Transform], ...] = (
    (lambda x: x, lambda x: x),
    (lambda x: x.flip(-1), lambda x: x.flip(-1)),
    (lambda x: x.mT, lambda x: x.mT),
    (lambda x: torch.rot90(x, 1, (-2, -1)), lambda x: torch.rot90(x, -1, (-2, -1))),
)
"""Test-time augmentation: mirrors and quarter turns, each with its inverse. A rotation by 180 degrees maps an autocorrelation
onto itself and is left out."""

SHRINK_THRESHOLDS = (0.03, 0.06, 0.1, 0.18)
"""A low threshold of shrink-wrap keeps faint structure, a high one keeps noise out of the support; the likelihood of the
resulting candidates decides between them."""

RETRIEVAL = {
    quality: HioOptions(starts=starts, iterations=300, error_reduction=50, shrink_from=100, shrink_every=30,
                        shrink_threshold=SHRINK_THRESHOLDS)
    for quality, starts in (("fast", 6), ("balanced", 40), ("best", 128))
}
"""The retrieval that makes proposals to the network: many starts are worth more than many iterations."""

AUGMENTED = {"fast": 1, "balanced": len(AUGMENTATIONS), "best": len(AUGMENTATIONS)}
"""Augmentations of an estimate. With one, only the overview of all starts is fused; with more, each start as well."""

KEPT = 8
"""Number of likeliest candidates that are averaged where no samples are drawn."""

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
        transfer: phase retrieval transfer function of the candidates, empty where there was one.
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


def retrieved(measurement: Measurement, denoised: torch.Tensor, quality: str, seed: int, device: str,
              progress: Progress = lambda: None) -> Candidates:
    """Classical retrieval from an estimate and from its denoised signal (127, 127), which has less noise but less fine
    structure, too: images (2, starts, 128, 128)."""
    moduli = torch.stack((fourier_modulus(measurement), denoised_modulus(denoised.cpu().numpy(), measurement)))
    rng = torch.Generator(device=device).manual_seed(seed)
    return hio(moduli.to(device), measurement.box, rng, RETRIEVAL[quality], progress)


@torch.no_grad()
def fuse(network: nn.Module, seen: Observation, shown: torch.Tensor, augmented: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Candidates from one observation beside each of n sets of classical reconstructions (n, PICTURES, 64, 64).

    The augmentations take turns, each undone in its candidate. Returns albedos (n, 64, 64) and logits (n,) of the correlations
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
    """Mean of the posterior's samples, which begin with the likeliest candidates: of all starts together, augmented, and of
    each start. Where no samples are drawn (`fast`, the paper's networks) the mean of the likeliest candidates."""
    augmented = AUGMENTED[quality]
    seen = observation([measurement]).part(slice(None), device)
    shown, agreement = seen.classical.expand(augmented, -1, -1, -1), [0.0, 0.0]
    if isinstance(network, CorrelographyNet):
        seen = replace(seen, denoised=denoise(network, seen, augmented))
        found = retrieved(measurement, seen.denoised[0], quality, seed, device, progress)
        together, agreement = overview(found)
        shown = together.expand(augmented, -1, -1, -1)
        if augmented > 1:
            shown = torch.cat((shown, proposals(found, len(SHRINK_THRESHOLDS))))
    albedos, expected = fuse(network, seen, shown, augmented)
    likeliest = log_likelihoods(albedos, measurement).argsort(descending=True, stable=True)
    kept, samples = albedos[likeliest[:KEPT]], None
    trust = float(expected[likeliest[:KEPT]].mean())
    if isinstance(network, CorrelographyNet) and quality in ANNEALING:
        drawn = posterior_samples(network.sampler, seen, measurement.noise.inflation, albedos[likeliest],
                                  ANNEALING[quality], torch.Generator().manual_seed(seed))
        samples, together = drawn.samples, _mean(drawn.samples, 0.0)
        image = _with_expected(together.image, drawn.expected)
    else:
        together = _mean(kept, 0.7)
        image = together.image
    averaged = kept if samples is None else samples
    features = ConfidenceFeatures(trust, with_one_more(together.agreement, len(averaged)), *agreement)
    return NetworkAnswer(image, features, together.transfer if len(likeliest) > 1 else (), samples)


def _with_expected(samples: torch.Tensor, expected: torch.Tensor) -> torch.Tensor:
    """Mean of samples (128, 128), and `EXPECTED` of the mean of albedos (n, 64, 64) laid over it; largest values 1."""
    placed, _ = registered(padded(normalised(expected)), samples)
    return (1.0 - EXPECTED) * normalised(samples) + EXPECTED * normalised(placed.mean(0))


def _mean(albedos: torch.Tensor, alike: float) -> Consensus:
    """Registered mean of albedos (n, 64, 64) that are alike, see `consensus`."""
    return consensus(padded(normalised(albedos)), torch.arange(len(albedos)), len(albedos), alike)
