"""Blind estimation of defocus and motion blur.

Blur multiplies the estimate by a factor H that falls with the lag; soft edges of the object have the same effect. However, the
r*r of an object with sharp edges seldom decays like H, so a reconstruction that ignores the blur leaves much of the estimate
unexplained. In this case the search reconstructs under several assumed blurs. It accepts the blur with the lowest log-likelihood
deficit over all reconstructions if the deficit falls enough (constants below).
Evidence: docs/research.md, "Unknown blur".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
import torch

from correlograph.lags import LAGS
from invert.likelihood.gamma import Likelihood
from invert.measure.estimate import Estimate, apply_blur_transfer
from invert.measure.spectrum import Measurement, read_measurement
from invert.methods import Reconstruction

BLURS = ((1.0, 1.0), (1.6, 1.6), (2.3, 2.3), (0.0, 1.44), (1.44, 0.0))
"""Candidate blurs: Gaussian standard deviations along rows and columns in 1/256 of a patch. The last two correspond to a motion
by 5/256 of a patch."""

MIN_GAIN_NATS, MIN_GAIN_FRACTION = 200.0, 0.6
"""Minimum reduction of the log-likelihood deficit by a reconstruction made with the blur, in nats and as a fraction."""

MIN_GAIN_FRACTION_OF_ALL = 0.2
"""Minimum fractional reduction of the lowest log-likelihood deficit over the reconstructions of all blurs."""

RECONSTRUCTIONS_PER_BLUR = 2
"""Reconstructions per blur; the one with the lower misfit counts."""

MAX_RECONSTRUCTIONS = RECONSTRUCTIONS_PER_BLUR * (1 + len(BLURS))
"""Maximum number of reconstructions of a search."""


def likelihood_before_division(estimate: Estimate) -> Likelihood:
    """Return the likelihood of an estimate that is not divided by its transfer, so that its noise is uniform over the lags."""
    return Likelihood.of(read_measurement(estimate.values, estimate.quantisation), transfer=estimate.transfer)


def estimate_blur(
    estimate: Estimate, reconstruct: Callable[[Measurement, int], Reconstruction]
) -> tuple[Estimate, Reconstruction | None]:
    """Search for a blur that explains the estimate.

    Returns:
        the estimate, with the blur in its `transfer` and `record` if one was found, and the reconstruction from it with seed
        number 0. The reconstruction is None if no search was made, for instance because the user gave the blur.

    Args:
        reconstruct: function that reconstructs a measurement; its second argument selects the seed.
    """
    undivided = read_measurement(estimate.values, estimate.quantisation)
    # More lags are chosen where the upper frequencies hold signal, which a blur removes.
    is_searchable = estimate.blur_pixels is None and estimate.record is not None and estimate.lag_grid.lags <= LAGS
    if not is_searchable or not undivided.detectable or not undivided.noise.dof:
        return estimate, None

    def misfit(tried: Estimate, made: Sequence[Reconstruction]) -> float:
        likelihood = Likelihood.of(undivided, transfer=tried.transfer)
        return min((likelihood.misfit(torch.from_numpy(one.albedo)) for one in made if one.object_found), default=np.inf)

    def attempts(tried: Estimate) -> list[Reconstruction]:
        """Reconstruct with the transfer of `tried` until one reconstruction explains the estimate or the attempts are used up."""
        measurement, made = read_measurement(tried.values, tried.quantisation, tried.transfer), []
        for number in range(RECONSTRUCTIONS_PER_BLUR):
            made.append(reconstruct(measurement, number))
            if misfit(tried, made[-1:]) < MIN_GAIN_NATS:
                break
        return made

    sharp = attempts(estimate)
    unexplained = misfit(estimate, sharp)
    if not MIN_GAIN_NATS < unexplained < np.inf:
        return estimate, sharp[0]
    rows, columns = estimate.record.grid.patch_shape
    tried = [apply_blur_transfer(estimate, (down * rows / 256, right * columns / 256)) for down, right in BLURS]
    made = [attempts(one) for one in tried]
    if unexplained - min(map(misfit, tried, made)) < max(MIN_GAIN_NATS, MIN_GAIN_FRACTION * unexplained):
        return estimate, sharp[0]
    # A reconstruction made with one blur may fit better with another.
    together = [*sharp, *chain(*made)]
    left = [misfit(one, together) for one in tried]
    if min(left) > (1.0 - MIN_GAIN_FRACTION_OF_ALL) * misfit(estimate, together):
        return estimate, sharp[0]
    best = int(np.argmin(left))
    record = replace(estimate.record, blur_found_pixels=tried[best].blur_pixels)
    return replace(tried[best], record=record), made[best][0]
