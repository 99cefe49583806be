"""Blur that nobody told of: a camera out of focus, or moved during the exposure.

Blur multiplies the estimate by H, which no estimate shows by itself: a softer object has such an estimate. But of objects with
edges r*r seldom fades like that, so that reconstructions leave much of the estimate unexplained. Then others are made as if
there were a blur, and one that explains most of what was left is taken for the frames'.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from invert.estimate import Estimate, blurred
from invert.likelihood import NoiseLikelihood
from invert.spectrum import Measurement, read_measurement

BLURS = ((1.0, 1.0), (1.6, 1.6), (2.3, 2.3), (0.0, 1.44), (1.44, 0.0))
"""Tried, in 1 / 256 of a patch: deviations of a Gaussian down and right; the last two are those of motion by five."""

LEAST_NATS, LEAST_SHARE = 200.0, 0.7
"""By how much a blur must lower the misfit, in nats and as a share. Of 27 captures of sharp letters none reached both, one came
near (700 nats, .68); of 27 out of focus by a pixel 15 did, those that lose most by it."""

TRIES = 2
"""Reconstructions of each; the better one counts, since a retrieval that fails explains nothing, blur or not."""


def likelihood_as_seen(estimate: Estimate) -> NoiseLikelihood:
    """That of the estimate before it is divided by its transfer."""
    return NoiseLikelihood(read_measurement(estimate.lags, estimate.quantisation), transfer=estimate.transfer)


def with_blur_found(estimate: Estimate, reconstructed: Callable[[Measurement, int], np.ndarray]) -> Estimate:
    """The estimate, a blur that explains it in its `transfer` and `facts`; as it is without one, and where the blur is known.

    Args:
        reconstructed: albedo (64, 64) of a measurement, zero where none is found; of another seed with each number.
    """
    as_seen = read_measurement(estimate.lags, estimate.quantisation)
    if estimate.blur_pixels is not None or "patches" not in estimate.facts or not as_seen.detectable or not as_seen.noise.dof:
        return estimate

    def misfit(tried: Estimate) -> float:
        seen = read_measurement(tried.lags, tried.quantisation, tried.transfer)
        likelihood, least = likelihood_as_seen(tried), np.inf
        for number in range(TRIES):
            albedo = torch.from_numpy(reconstructed(seen, number))
            least = min(least, likelihood.misfit(albedo) if albedo.any() else np.inf)
            if least < LEAST_NATS:
                break
        return least

    sharp = misfit(estimate)
    if not LEAST_NATS < sharp < np.inf:
        return estimate
    patches = estimate.facts["patches"]
    tried = [blurred(estimate, (down * patches["size"] / 256, right * patches["width"] / 256)) for down, right in BLURS]
    left = [misfit(one) for one in tried]
    if sharp - min(left) < max(LEAST_NATS, LEAST_SHARE * sharp):
        return estimate
    best = tried[int(np.argmin(left))]
    return replace(best, facts=best.facts | {"blur_found_pixels": best.blur_pixels})
