"""Blind estimation of defocus and motion blur.

Blur multiplies the estimate by a factor H that falls with the lag; soft edges of the object have the same effect. The likelihood alone
cannot tell them apart, but two limits hold. Blur lowers the contrast of the speckle, which is 1 otherwise: blurs that would raise it above
1 when they are divided out are impossible. Ambient light, an unknown offset and a second polarisation lower the contrast, too, but leave
r*r as it is. And no lag of r*r exceeds zero lag: so are blurs that would raise one above it. If a reconstruction without blur leaves much
of the estimate unexplained, the search reconstructs under possible blurs. It accepts the one that explains most if it halves the deficit in
log-likelihood, if the network trusts the picture as well, and if the picture changes. The reconstruction of the explanation that was not
chosen is kept: where it differs, so may the truth.
Evidence: docs/research.md, "Unknown blur".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from correlograph.lags import LAGS
from invert.albedo.metrics import aligned_pearson
from invert.likelihood.gamma import Likelihood
from invert.measure.contrast import FULL_SIGMA, signal_sum
from invert.measure.estimate import Estimate, apply_blur_transfer
from invert.measure.spectrum import Measurement, read_measurement
from invert.methods import Reconstruction

Blur = tuple[float, float]

KINDS: dict[Blur, tuple[float, ...]] = {(1.0, 1.0): (1.0, 0.7, 0.45), (0.0, 1.0): (1.0,), (1.0, 0.0): (1.0,)}
"""Kinds of blur along rows and columns, defocus and motion, and the fractions of the largest possible one of each kind that are tried. Less
than the largest is left if other light or a second polarisation has lowered the contrast as well."""

MAX_BLUR, RESOLUTION = 0.13, 2e-4
"""Largest standard deviation of a candidate, little below what `apply_blur_transfer` takes, and the resolution of the largest one that is
possible, as fractions of a patch."""

MAX_OVER_ZERO, MAX_OVER_SIGMA = 1.3, 4.5
"""A blur is impossible if a lag of the estimate that is divided by it exceeds those next to zero by this factor and so many standard
errors."""

MIN_RESTORED = 0.5
"""Squared contrast below which other light is certain. The largest blur restores less than 1 without it, too, because lags that it hides in
noise are lost."""

MIN_GAIN_NATS, MIN_GAIN_FRACTION = 200.0, 0.5
"""Minimum reduction of the log-likelihood deficit by a blur that is accepted, in nats and as a fraction of the deficit without blur."""

MAX_CONFIDENCE_LOSS = 0.09
"""A blur is not accepted if the confidence of the reconstruction with it is lower by more than this."""

MAX_LIKENESS = 0.9
"""Maximum correlation of the pictures with a blur and without; one that changes less is often noise of a flat or dark frame."""

RECONSTRUCTIONS_PER_BLUR = 2
"""Reconstructions per blur; the one with the lower misfit counts."""

MAX_RECONSTRUCTIONS = RECONSTRUCTIONS_PER_BLUR * (1 + sum(map(len, KINDS.values())))
"""Maximum number of reconstructions of a search."""


@dataclass(frozen=True)
class BlurSearch:
    """Outcome of a search for an unknown blur.

    Attributes:
        estimate: the estimate, with the blur in its `transfer` and `record` if one was found.
        draft: the reconstruction from it with seed number 0; None if no search was made, for instance because the user gave the blur.
        other: the best reconstruction with a blur if none was found, and without one otherwise; None if there is no other explanation.
    """

    estimate: Estimate
    draft: Reconstruction | None = None
    other: Reconstruction | None = None


def likelihood_before_division(estimate: Estimate) -> Likelihood:
    """Return the likelihood of an estimate that is not divided by its transfer, so that its noise is uniform over the lags."""
    return Likelihood.of(read_measurement(estimate.values, estimate.quantisation), transfer=estimate.transfer)


def search_blur(estimate: Estimate, reconstruct: Callable[[Measurement, int], Reconstruction]) -> BlurSearch:
    """Search for a blur that explains the estimate.

    Args:
        reconstruct: function that reconstructs a measurement; its second argument selects the seed.
    """
    undivided = read_measurement(estimate.values, estimate.quantisation)
    # More lags are chosen where the upper frequencies hold signal, which a blur removes. What is left of other objects looks like a blur.
    record = estimate.record
    is_searchable = record is not None and record.object_number is None and estimate.lag_grid.lags <= LAGS
    if not is_searchable or estimate.blur_pixels is not None or not undivided.detectable or not undivided.noise.dof:
        return BlurSearch(estimate)
    if not (largest := largest_blurs(estimate)):
        return BlurSearch(estimate)
    noted = replace(record, needs_other_light=_needs_other_light(estimate, largest))
    return _Search(undivided, reconstruct).run(replace(estimate, record=noted), largest)


@dataclass(frozen=True)
class _Search:
    undivided: Measurement
    reconstruct: Callable[[Measurement, int], Reconstruction]

    def run(self, estimate: Estimate, largest: dict[Blur, Blur]) -> BlurSearch:
        sharp = self.attempts(estimate)
        unexplained = min(self.misfits(estimate, sharp))
        if not np.isfinite(unexplained):
            return BlurSearch(estimate, sharp[0])
        tried = [one for kind, size in largest.items() for one in _blurred_by(estimate, size, KINDS[kind])]
        if unexplained < MIN_GAIN_NATS:
            return BlurSearch(estimate, sharp[0], self.reconstruct(_read(tried[0]), 0))
        made = [self.attempts(one) for one in tried]
        misfits = [self.misfits(one, each) for one, each in zip(tried, made, strict=True)]
        best = min(range(len(tried)), key=lambda index: min(misfits[index]))
        blurred, found, left = tried[best], made[best][0], min(misfits[best])
        explains_more = unexplained - left >= max(MIN_GAIN_NATS, MIN_GAIN_FRACTION * unexplained)
        if not explains_more or not _is_better(found, sharp[0]):
            return BlurSearch(estimate, sharp[0], made[best][misfits[best].index(left)])
        assert estimate.record is not None
        record = replace(estimate.record, blur_found_pixels=blurred.blur_pixels)
        return BlurSearch(replace(blurred, record=record), found, sharp[0])

    def misfits(self, tried: Estimate, made: Sequence[Reconstruction]) -> list[float]:
        """Return the log-likelihood deficit of each reconstruction with the transfer of `tried`; infinite without an object."""
        likelihood = Likelihood.of(self.undivided, transfer=tried.transfer)
        return [likelihood.misfit(torch.from_numpy(one.albedo)) if one.object_found else np.inf for one in made]

    def attempts(self, tried: Estimate) -> list[Reconstruction]:
        """Reconstruct with the transfer of `tried` until one reconstruction explains the estimate or the attempts are used up."""
        made: list[Reconstruction] = []
        for number in range(RECONSTRUCTIONS_PER_BLUR):
            made.append(self.reconstruct(_read(tried), number))
            if self.misfits(tried, made[-1:])[0] < MIN_GAIN_NATS:
                break
        return made


def _is_better(found: Reconstruction, sharp: Reconstruction) -> bool:
    """Return whether a reconstruction with a blur may stand for that without: the network trusts it as much, and they differ."""
    if not found.object_found or found.confidence < sharp.confidence - MAX_CONFIDENCE_LOSS:
        return False
    return aligned_pearson(found.albedo, sharp.albedo)[0] <= MAX_LIKENESS


def largest_blurs(estimate: Estimate) -> dict[Blur, Blur]:
    """Return the largest possible blur of each kind, in pixels; none if the contrast of the speckle leaves no room for one."""
    assert estimate.record is not None
    contrast = estimate.record.contrast
    if contrast is not None and contrast.is_full:
        return {}
    most = np.inf if contrast is None else signal_sum(_read(estimate)) / contrast.square
    undivided = read_measurement(estimate.values, estimate.quantisation)

    def is_possible(blurred: Estimate) -> bool:
        return not _exceeds_zero_lag(undivided, blurred.transfer) and signal_sum(_read(blurred)) <= most

    return {kind: _largest_blur(estimate, kind, is_possible) for kind in KINDS}


def _needs_other_light(estimate: Estimate, largest: dict[Blur, Blur]) -> bool:
    """Return whether the squared contrast stays below `MIN_RESTORED` even if the largest possible blurs are divided out."""
    assert estimate.record is not None
    contrast, total = estimate.record.contrast, signal_sum(_read(estimate))
    if contrast is None:
        return False
    rises = [signal_sum(_read(apply_blur_transfer(estimate, size))) / total for size in largest.values()]
    return max(rises) * (contrast.square + FULL_SIGMA * contrast.error) < MIN_RESTORED


def _blurred_by(estimate: Estimate, blur: Blur, fractions: Sequence[float]) -> list[Estimate]:
    """Return the estimate with each fraction of a blur in its transfer."""
    return [apply_blur_transfer(estimate, (part * blur[0], part * blur[1])) for part in fractions]


def _largest_blur(estimate: Estimate, kind: Blur, is_possible: Callable[[Estimate], bool]) -> Blur:
    """Return the largest possible blur of a kind by bisection."""
    assert estimate.record is not None
    rows, columns = (share * side for share, side in zip(kind, estimate.record.grid.patch_shape, strict=True))
    possible, impossible = 0.0, MAX_BLUR
    while impossible - possible > RESOLUTION:
        middle = 0.5 * (possible + impossible)
        blurred = apply_blur_transfer(estimate, (middle * rows, middle * columns))
        possible, impossible = (middle, impossible) if is_possible(blurred) else (possible, middle)
    return possible * rows, possible * columns


def _exceeds_zero_lag(undivided: Measurement, transfer: np.ndarray) -> bool:
    """Return whether a lag of an estimate that is divided by a transfer surely exceeds those next to zero lag."""
    noise, ring = undivided.noise, undivided.lag_grid.ring
    signal = undivided.values.astype(np.float64) - noise.floor
    near, inside = ring == 2, (ring > 2) & (ring <= noise.signal_ring)
    limit = MAX_OVER_ZERO * (signal[near] / transfer[near]).max() * transfer
    return bool((signal - MAX_OVER_SIGMA * undivided.values / noise.dof**0.5 > limit)[inside].any())


def _read(estimate: Estimate) -> Measurement:
    return read_measurement(estimate.values, estimate.quantisation, estimate.transfer)
