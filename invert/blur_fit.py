"""Blind estimation of defocus and motion blur.

Blur multiplies the estimate by a factor H that falls with the lag; soft edges of the object have the same effect. The likelihood alone
cannot tell them apart, but blur also lowers the contrast of the speckle, which is 1 otherwise. Blurs that would raise the contrast above 1
when they are divided out are therefore excluded, and the largest that remains explains the whole loss. Ambient light and a second
polarisation lower the contrast, too, but leave r*r as it is: if a reconstruction without blur leaves much of the estimate unexplained, the
search reconstructs under the blurs that the contrast allows. It accepts the one with the lowest log-likelihood deficit over all
reconstructions if the deficit falls enough (constants below).
Evidence: docs/research.md, "Unknown blur".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
import torch
from scipy.optimize import brentq

from correlograph.lags import LAGS
from invert.likelihood.gamma import Likelihood
from invert.measure.contrast import signal_sum
from invert.measure.estimate import Estimate, apply_blur_transfer
from invert.measure.spectrum import Measurement, read_measurement
from invert.methods import Reconstruction

BLURS = {(1.0, 1.0): (1.0, 0.7, 0.45), (0.0, 1.0): (1.0,), (1.0, 0.0): (1.0,)}
"""Kinds of blur along rows and columns, defocus and motion, and the fractions of the largest possible one of each kind that are tried. Less
than the largest is left if other light or a second polarisation has lowered the contrast as well."""

MAX_BLUR = 2.3
"""Largest standard deviation of a candidate in 1/256 of a patch; more leaves too few lags."""

MIN_GAIN_NATS = 200.0
"""Minimum reduction of the log-likelihood deficit by a blur, in nats."""

MIN_GAIN_FRACTION, MIN_GAIN_FRACTION_OF_ALL = 0.6, 0.2
"""Minimum fractional reduction of the deficit by a reconstruction made with the blur, and of the lowest deficit over the reconstructions of
all blurs."""

RECONSTRUCTIONS_PER_BLUR = 2
"""Reconstructions per blur; the one with the lower misfit counts."""

MAX_RECONSTRUCTIONS = RECONSTRUCTIONS_PER_BLUR * (1 + sum(map(len, BLURS.values())))
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
    # More lags are chosen where the upper frequencies hold signal, which a blur removes. What is left of other objects looks like a blur.
    record = estimate.record
    is_searchable = record is not None and record.object_number is None and estimate.lag_grid.lags <= LAGS
    if not is_searchable or estimate.blur_pixels is not None or not undivided.detectable or not undivided.noise.dof:
        return estimate, None
    if not (tried := possible_blurs(estimate)):
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
    made = [attempts(one) for one in tried]
    if not _explains_more(min(map(misfit, tried, made)), unexplained, MIN_GAIN_FRACTION):
        return estimate, sharp[0]
    # A reconstruction made with one blur may fit better with another, or without.
    together = [*sharp, *chain(*made)]
    left = [misfit(one, together) for one in tried]
    if not _explains_more(min(left), misfit(estimate, together), MIN_GAIN_FRACTION_OF_ALL):
        return estimate, sharp[0]
    best = int(np.argmin(left))
    record = replace(estimate.record, blur_found_pixels=tried[best].blur_pixels)
    return replace(tried[best], record=record), made[best][0]


def _explains_more(left: float, unexplained: float, fraction: float) -> bool:
    """Return whether a blur lowers what is left unexplained by `MIN_GAIN_NATS` and by a fraction."""
    return unexplained - left >= max(MIN_GAIN_NATS, fraction * unexplained)


def possible_blurs(estimate: Estimate) -> list[Estimate]:
    """Return the estimate with each candidate blur in its transfer; none if the contrast of the speckle leaves no room for one.

    Without blur, speckle has at most contrast 1, so that dividing by a blur must not raise the contrast above it.
    """
    assert estimate.record is not None
    contrast = estimate.record.contrast
    if contrast is not None and contrast.is_full:
        return []
    most = np.inf if contrast is None else _signal_sum(estimate) / contrast.square
    found = []
    for kind, fractions in BLURS.items():
        largest = _largest_blur(estimate, kind, most)
        found += [apply_blur_transfer(estimate, (part * largest[0], part * largest[1])) for part in fractions]
    return found


def _largest_blur(estimate: Estimate, kind: tuple[float, float], most: float) -> tuple[float, float]:
    """Return the blur of a kind that raises the signal to its sum at contrast 1, `most`, when it is divided out, in pixels, but at most
    `MAX_BLUR`."""
    assert estimate.record is not None
    rows, columns = (
        MAX_BLUR / 256.0 * side * share for side, share in zip(estimate.record.grid.patch_shape, kind, strict=True)
    )

    def excess(size: float) -> float:
        return _signal_sum(apply_blur_transfer(estimate, (size * rows, size * columns))) - most

    size = 1.0 if excess(1.0) <= 0.0 else float(brentq(excess, 0.0, 1.0, xtol=1e-2))
    return size * rows, size * columns


def _signal_sum(estimate: Estimate) -> float:
    return signal_sum(read_measurement(estimate.values, estimate.quantisation, estimate.transfer))
