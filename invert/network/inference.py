"""Reconstruction by the network: denoise the estimate, retrieve the phase, fuse, sample the posterior, average.

All this happens on 64 lags. On more lags, the same window is first reconstructed on 64 coarser ones; the sampler then continues
with its samples on grids up to twice as fine each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from correlograph.errors import InputError
from correlograph.lags import LAGS, OBJECT_SIDE
from correlograph.progress import Progress, no_progress
from invert.albedo.registration import (
    Consensus,
    centre_each,
    consensus,
    crop_centred,
    normalise_peak,
    register_images,
    zero_pad,
)
from invert.choices import FAST, Quality
from invert.measure.coarsen import coarsen, pad
from invert.measure.lag_choice import SIDE_STEP
from invert.measure.spectrum import Measurement, denoised_modulus, fourier_modulus
from invert.network.annealing import INITIAL_SCHEDULE, Annealing, Chain, sample_posterior
from invert.network.blocks import autocast
from invert.network.confidence import ConfidenceFeatures, logit_correlation_with_new_sample
from invert.network.features import Observation
from invert.network.finer_lags import enlarge, finer_progress_steps, sample_on_finer_lags
from invert.network.model import CorrelographyNet
from invert.network.retrieval_summary import summarise_retrievals
from invert.solvers.base import Candidates, PhaseProblem, solve
from invert.solvers.hio import Hio

Transform = Callable[[torch.Tensor], torch.Tensor]

AUGMENTATIONS: tuple[tuple[Transform, Transform], ...] = (
    (lambda x: x, lambda x: x),
    (lambda x: x.flip(-1), lambda x: x.flip(-1)),
    (lambda x: x.mT, lambda x: x.mT),
    (lambda x: torch.rot90(x, 1, (-2, -1)), lambda x: torch.rot90(x, -1, (-2, -1))),
)
"""Test-time augmentation: mirrors and quarter turns, each with its inverse. A rotation by 180 degrees maps an autocorrelation
onto itself and is not among them."""

RETRIEVAL = Hio(iterations=300, error_reduction=50, shrink_from=100, shrink_every=30, shrink_threshold=(0.03, 0.06, 0.1, 0.18))
"""Options of the phase retrieval before the fusion. A low threshold of shrink-wrap keeps faint structure; a high one keeps noise
out of the support."""

SAMPLER_STEP = 20
"""Progress steps of one denoising step of the sampler, which takes about as long as this many phase retrieval iterations."""

DENOISED_MEAN_WEIGHT, FUSION_WEIGHT = 0.5, 0.25
"""Weights of the mean denoiser output and of the fusion in the reconstruction; the rest is the mean of the samples. Evidence:
docs/research.md."""

UNBOUNDED_DOF = 1e6
"""K of an estimate without measurable noise."""


@dataclass(frozen=True)
class NetworkOutput:
    """Reconstruction by a network.

    Attributes:
        image: (128, 128), periodic.
        features: inputs of the confidence.
        transfer: phase retrieval transfer function of the samples or augmentations; empty for a single one.
        samples: equally likely samples of the posterior, (n, 64, 64); None without a sampler.
        most_confident: upper limit of the confidence: on finer lags, the mean correlation of the samples.
    """

    image: torch.Tensor
    features: ConfidenceFeatures
    transfer: tuple[float, ...]
    samples: torch.Tensor | None = None
    most_confident: float = 1.0


def network_progress_steps(quality: Quality) -> int:
    """Return how many steps of progress `reconstruct_by_network` reports."""
    schedule = Annealing.of(quality)
    denoising = INITIAL_SCHEDULE["steps"] + (schedule.rounds + 1) * schedule.steps if quality.samples else 0
    return RETRIEVAL.iterations + SAMPLER_STEP * int(denoising)


def predict(network: nn.Module, observation: Observation) -> Any:
    """Run a network, or one part of it, on observations (see `autocast`); float32 outside.

    Networks that reconstruct return albedos (n, 64, 64) and logits of their predicted correlations with the truth.
    """
    with autocast(observation.values.device):
        return network(observation)


def make_observation(measurements: Sequence[Measurement]) -> Observation:
    """Convert measurements to the input of a network."""
    return Observation.from_estimate(
        torch.from_numpy(np.stack([one.values for one in measurements])),
        torch.tensor([one.noise.floor for one in measurements], dtype=torch.float32),
        torch.tensor([one.noise.dof or UNBOUNDED_DOF for one in measurements], dtype=torch.float32),
    )


@torch.no_grad()
def denoise(network: CorrelographyNet, observation: Observation, augmentations: int) -> torch.Tensor:
    """Return the signals (n, 127, 127) of observations, floor and noise removed, averaged over augmentations."""
    denoised = []
    for transform, inverse in AUGMENTATIONS[:augmentations]:
        transformed = Observation.from_estimate(transform(observation.values), observation.floor, observation.dof)
        denoised.append(inverse(predict(network.denoiser, transformed)))
    return torch.stack(denoised).mean(0)


def run_phase_retrieval(
    measurement: Measurement,
    denoised: torch.Tensor,
    starts: int,
    seed: int,
    device: str,
    progress: Progress = no_progress,
) -> Candidates:
    """Retrieve the phase from an estimate and from its denoised signal (127, 127); images (2, starts, 128, 128).

    The denoised signal has less noise, but also less fine structure.
    """
    moduli = torch.stack((fourier_modulus(measurement), denoised_modulus(denoised.cpu().numpy(), measurement)))
    rng = torch.Generator(device=device).manual_seed(seed)
    return solve(replace(RETRIEVAL, starts=starts), PhaseProblem(moduli.to(device), measurement.box), rng, progress)


@torch.no_grad()
def fuse(
    network: nn.Module, observation: Observation, classical: torch.Tensor, augmentations: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Fuse one observation with each of n sets of classical reconstructions (n, PICTURES, 64, 64).

    The augmentations rotate through the sets and are undone in the albedos. Returns albedos (n, 64, 64) and logits (n,) of
    their predicted correlations with the truth.
    """
    pairs = [AUGMENTATIONS[index % augmentations] for index in range(len(classical))]
    estimate, denoised = (
        torch.cat([transform(one) for transform, _ in pairs]) for one in (observation.values, observation.denoised)
    )
    images = torch.stack([transform(one) for (transform, _), one in zip(pairs, classical, strict=True)])
    floor, dof = observation.floor.expand(len(classical)), observation.dof.expand(len(classical))
    albedo, predicted = predict(network, Observation(estimate, floor, dof, denoised, images))
    return torch.stack([inverse(one) for (_, inverse), one in zip(pairs, albedo, strict=True)]), predicted


def reconstruct_by_network(
    network: nn.Module,
    measurement: Measurement,
    quality: Quality,
    seed: int,
    device: str,
    progress: Progress = no_progress,
) -> NetworkOutput:
    """Return the posterior mean; without a sampler (`fast`, the U-nets of Metzler et al. 2020) the mean over augmentations.

    Raises InputError for lags that the network does not accept.
    """
    target = measurement.lag_grid.object_side
    if not isinstance(network, CorrelographyNet):
        if target != OBJECT_SIDE:
            raise InputError("lags", f"{LAGS} for the networks of Metzler et al. 2020", target - 1, "omit --lags or --weights")
        return _reconstruct_on_first_lags(network, measurement, quality, seed, device, progress)
    coarsest = coarsen(measurement, OBJECT_SIDE) if target > OBJECT_SIDE else pad(measurement, OBJECT_SIDE)
    output = _reconstruct_on_first_lags(network, coarsest, quality, seed, device, progress)
    for side in _finer_sides(target):
        finer = coarsen(measurement, side) if side < target else pad(measurement, side)
        output = _continue_on_finer_lags(network, finer, output, quality, seed, device)
    if output.samples is None or output.samples.shape[-1] == target:
        return output
    return replace(output, samples=centre_each(output.samples, target))


def _finer_sides(side: int) -> list[int]:
    """Return the sides of the grids on which sampling continues after the grid of 64 lags, smallest first.

    Each is at most twice the one before. The last is `side`, rounded up to a multiple of `SIDE_STEP`, which the U-net can halve.
    """
    last = -(-side // SIDE_STEP) * SIDE_STEP
    sides = []
    while last > OBJECT_SIDE:
        sides.append(last)
        last = max(OBJECT_SIDE, -(-last // (2 * SIDE_STEP)) * SIDE_STEP)
    return sides[::-1]


def _continue_on_finer_lags(
    network: CorrelographyNet,
    measurement: Measurement,
    coarse: NetworkOutput,
    quality: Quality,
    seed: int,
    device: str,
) -> NetworkOutput:
    """Enlarge the samples of a coarser grid (without samples, its image), and continue to sample with them; show the time left."""
    shown = crop_centred(coarse.image)[None] if coarse.samples is None else coarse.samples
    starts = enlarge(shown[: quality.finer_samples], measurement.lag_grid.object_side)
    hint = "" if quality == FAST else f"; --quality {FAST} is quicker"
    title, total = f"{measurement.lag_grid.lags} lags{hint}", finer_progress_steps(quality, len(starts))
    with tqdm(total=total, desc=title, unit="step", disable=None, leave=False) as bar:
        observation = make_observation([measurement]).part(slice(None), device)
        rng = torch.Generator().manual_seed(seed)
        chain = Chain(network.sampler, observation, measurement.noise.inflation, rng, bar.update)
        found = sample_on_finer_lags(chain, measurement, starts, quality)
    if coarse.samples is None:
        return replace(coarse, image=found.image)
    agreement = logit_correlation_with_new_sample(found.together.agreement, len(starts))
    features = coarse.features._replace(agreement=agreement)
    return NetworkOutput(found.image, features, found.together.transfer, found.samples, found.together.agreement)


def _reconstruct_on_first_lags(
    network: nn.Module, measurement: Measurement, quality: Quality, seed: int, device: str, progress: Progress
) -> NetworkOutput:
    observation = make_observation([measurement]).part(slice(None), device)
    classical, agreement, found, samples = observation.classical, [0.0, 0.0], None, None
    if isinstance(network, CorrelographyNet):
        observation = replace(observation, denoised=denoise(network, observation, quality.augmentations))
        found = run_phase_retrieval(measurement, observation.denoised[0], quality.network_starts, seed, device, progress)
        summary, agreement = summarise_retrievals(found)
        classical = summary[None]
    classical = classical.expand(quality.augmentations, -1, -1, -1)
    albedos, predicted = fuse(network, observation, classical, quality.augmentations)
    if found is not None and quality.samples:
        candidates = torch.cat((albedos, _crop_starts(found)))
        chain = Chain(
            network.sampler,
            observation,
            measurement.noise.inflation,
            torch.Generator().manual_seed(seed),
            lambda steps=1: progress(SAMPLER_STEP * steps),
        )
        sampled = sample_posterior(chain, candidates, Annealing.of(quality))
        samples, together = sampled.samples, _registered_mean(sampled.samples, 0.0)
        image = _blend(together.image, sampled.denoised_means, albedos)
    else:
        together = _registered_mean(albedos, 0.7)
        image = together.image
    count = len(albedos) if samples is None else len(samples)
    expected_agreement = logit_correlation_with_new_sample(together.agreement, count)
    features = ConfidenceFeatures(float(predicted.mean()), expected_agreement, *agreement)
    return NetworkOutput(image, features, together.transfer if count > 1 else (), samples)


def _crop_starts(found: Candidates) -> torch.Tensor:
    """Crop every start of a phase retrieval to an albedo (n, 64, 64), maximum 1."""
    return normalise_peak(torch.stack([crop_centred(one) for one in found.images.flatten(0, 1)]))


def _blend(mean_sample: torch.Tensor, denoised_means: torch.Tensor, fused: torch.Tensor) -> torch.Tensor:
    """Blend the mean sample (128, 128) with the means of denoiser outputs and of fused images (n, 64, 64), registered to it.

    Each has maximum 1.
    """
    blended = (1.0 - DENOISED_MEAN_WEIGHT - FUSION_WEIGHT) * normalise_peak(mean_sample)
    for weight, images in ((DENOISED_MEAN_WEIGHT, denoised_means), (FUSION_WEIGHT, fused)):
        registered, _ = register_images(zero_pad(normalise_peak(images)), mean_sample)
        blended = blended + weight * normalise_peak(registered.mean(0))
    return blended


def _registered_mean(albedos: torch.Tensor, min_relative_correlation: float) -> Consensus:
    """Register albedos (n, 64, 64) and average those that agree; see `consensus`."""
    return consensus(zero_pad(normalise_peak(albedos)), torch.arange(len(albedos)), len(albedos), min_relative_correlation)
