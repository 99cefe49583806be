"""Continuation of a reconstruction on finer lags.

It starts from the samples of a coarser grid. Every round adds noise to them and denoises them, as on the coarse grid; each sample
then ascends its likelihood, because more lags determine more detail than the few data-consistency steps of a round can reach.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch.nn import functional

from invert.albedo.registration import Consensus, centre_each, consensus, normalise_peak, register_images, zero_pad
from invert.choices import Quality
from invert.likelihood.refinement import refine_by_likelihood
from invert.measure.spectrum import RESOLUTION_LAGS, Measurement
from invert.network.annealing import Annealing, Chain, run_annealing
from invert.network.data_steps import replace_unlikely_samples
from invert.solvers.base import gaussian_blur

LATE_FIRST_SIGMA = 0.4
"""Highest noise level of the second half of the rounds, which correct smaller errors."""

DENOISED_WEIGHT = 0.3
"""Weight of the mean denoiser output of the last two rounds in the image; the rest is the mean of the samples."""


@dataclass(frozen=True)
class FinerSamples:
    """Samples on finer lags (n, side, side), maximum 1; their registered mean, and the image, periodic (2 side, 2 side)."""

    samples: torch.Tensor
    together: Consensus
    image: torch.Tensor


def enlarge(albedos: torch.Tensor, side: int) -> torch.Tensor:
    """Interpolate albedos (n, H, H) to (n, side, side), maximum 1 each."""
    larger = functional.interpolate(albedos[:, None], size=(side, side), mode="bicubic")[:, 0]
    return normalise_peak(larger.clamp_min(0.0))


def finer_progress_steps(quality: Quality, samples: int) -> int:
    """Return how many steps of progress `sample_on_finer_lags` reports: denoising steps of all samples, and ascents of each."""
    return quality.finer_rounds * (Annealing(samples, 1).steps + samples)


def sample_on_finer_lags(chain: Chain, measurement: Measurement, starts: torch.Tensor, quality: Quality) -> FinerSamples:
    """Continue to sample on the lags of a measurement; the resolution of the image is limited to half a lag, because the ascent
    fits noise at the highest frequencies.

    Args:
        chain: the sampling of this measurement.
        starts: samples of the coarser grid, (n, side, side).
    """
    samples, denoised = starts, []
    for number in range(quality.finer_rounds):
        options = Annealing(len(starts), 1)
        if 2 * number >= quality.finer_rounds and number:
            options = replace(options, first=LATE_FIRST_SIGMA)
        likely = replace_unlikely_samples(chain.data, samples, samples[:0])
        centred = centre_each(likely)
        samples, expected = run_annealing(chain, centred, options)
        denoised.append(normalise_peak(expected))
        refined = []
        for one in normalise_peak(samples):
            refined.append(refine_by_likelihood(one, measurement))
            chain.progress()
        samples = torch.stack(refined)
    together = consensus(zero_pad(samples), torch.arange(len(samples)), len(samples), 0.0)
    mean = normalise_peak(together.image)
    registered, _ = register_images(zero_pad(torch.cat(denoised[-2:])), mean)
    image = (1.0 - DENOISED_WEIGHT) * mean + DENOISED_WEIGHT * normalise_peak(registered.mean(0))
    return FinerSamples(samples, together, gaussian_blur(image, RESOLUTION_LAGS))
