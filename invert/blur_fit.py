"""A blur that is not known: a camera out of focus, or moved during the exposure.

Blur multiplies the estimate by H, and a softer object would look the same. But objects with edges seldom have an r*r that fades
like that, so reconstructions leave much of the estimate unexplained. Then reconstructions are made with each of some blurs;
where one explains six tenths of what was left, the blur that fits best with any of all these reconstructions is accepted,
provided that it lowers the least misfit by a fifth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
import torch

from invert.likelihood.gamma import NoiseLikelihood
from invert.measure.estimate import Estimate, blurred
from invert.measure.spectrum import Measurement, read_measurement
from invert.methods import Reconstruction

BLURS = ((1.0, 1.0), (1.6, 1.6), (2.3, 2.3), (0.0, 1.44), (1.44, 0.0))
"""Tried, in 1 / 256 of a patch: deviations of a Gaussian down and right; the last two are those of motion by five."""

LEAST_NATS, LEAST_SHARE = 200.0, 0.6
"""By how much a blur must lower the misfit of its own reconstructions, in nats and as a share."""

LEAST_SHARE_OF_ALL = 0.2
"""By which share it must lower the least misfit of all reconstructions. Of 30 captures of sharp letters, edges, characters and
grey pieces, one of a grey piece reached this and the above, and was drawn as well; of 30 out of focus by a pixel 16 (a gain in
correlation of .08, the mean of the 30), of 30 moved by five pixels 15 (.07), five of these 31 as of another blur."""

TRIES = 2
"""Reconstructions of each; the better one counts, since a retrieval that fails explains nothing, blur or not."""


def likelihood_as_seen(estimate: Estimate) -> NoiseLikelihood:
    """That of the estimate before it is divided by its transfer."""
    return NoiseLikelihood(read_measurement(estimate.lags, estimate.quantisation), transfer=estimate.transfer)


def with_blur_found(
    estimate: Estimate, reconstructed: Callable[[Measurement, int], Reconstruction]
) -> tuple[Estimate, Reconstruction | None]:
    """The estimate, a blur that explains it in its `transfer` and `facts`, and the first reconstruction made of it.

    Without such a blur the estimate is as it was; where the blur is known, none is looked for and no reconstruction made.

    Args:
        reconstructed: of a measurement, from another seed with each number.
    """
    as_seen = read_measurement(estimate.lags, estimate.quantisation)
    if estimate.blur_pixels is not None or "patches" not in estimate.facts or not as_seen.detectable or not as_seen.noise.dof:
        return estimate, None

    def misfit(tried: Estimate, made: Sequence[Reconstruction]) -> float:
        likelihood = NoiseLikelihood(as_seen, transfer=tried.transfer)
        return min((likelihood.misfit(torch.from_numpy(one.albedo)) for one in made if one.object_found), default=np.inf)

    def attempts(tried: Estimate) -> list[Reconstruction]:
        """Reconstructions as if the blur were such, up to the first that explains the estimate."""
        seen, made = read_measurement(tried.lags, tried.quantisation, tried.transfer), []
        for number in range(TRIES):
            made.append(reconstructed(seen, number))
            if misfit(tried, made[-1:]) < LEAST_NATS:
                break
        return made

    sharp = attempts(estimate)
    unexplained = misfit(estimate, sharp)
    if not LEAST_NATS < unexplained < np.inf:
        return estimate, sharp[0]
    patches = estimate.facts["patches"]
    tried = [blurred(estimate, (down * patches["size"] / 256, right * patches["width"] / 256)) for down, right in BLURS]
    made = [attempts(one) for one in tried]
    if unexplained - min(map(misfit, tried, made)) < max(LEAST_NATS, LEAST_SHARE * unexplained):
        return estimate, sharp[0]
    # What was made with one blur may fit better with another.
    together = [*sharp, *chain(*made)]
    left = [misfit(one, together) for one in tried]
    if min(left) > (1.0 - LEAST_SHARE_OF_ALL) * misfit(estimate, together):
        return estimate, sharp[0]
    best = int(np.argmin(left))
    return replace(tried[best], facts=estimate.facts | {"blur_found_pixels": tried[best].blur_pixels}), made[best][0]
