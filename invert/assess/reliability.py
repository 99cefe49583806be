"""Reliability of a reconstruction: lower confidence if the data do not support it, and what limits it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import torch
from scipy.stats import norm

from correlograph.lags import OBJECT_SIDE
from invert.albedo.metrics import aligned_pearson
from invert.albedo.posterior import Samples
from invert.assess.doubts import FALSE_ALARMS_EACH, Doubt, DoubtKind
from invert.assess.hypotheses import Hypothesis, object_probability, texture_before
from invert.assess.speckle_test import SpeckleTest
from invert.likelihood.gamma import Likelihood
from invert.measure.estimate import Estimate, EstimateRecord
from invert.measure.spectrum import Measurement
from invert.methods import Reconstruction
from radiometry.noise.detection import DETECTION_LIMIT

MAX_UNVERIFIED_CONFIDENCE = 0.5
"""Maximum confidence if the light may not be speckle of the object, or if the reconstruction does not explain the estimate."""

MIN_MOMENT_RATIO, MAX_MOMENT_RATIO = 0.25, 1.3
"""Range of the third moment, in units of that of speckle. Texture lies below it; specular highlights lie above it."""

MAX_DEFICIT_NATS, MAX_DEFICIT_FRACTION = 100.0, 0.04
"""Maximum log-likelihood deficit of the most likely sample, in nats and as a fraction of the deficit without an object. Evidence:
docs/research.md."""


def find_doubts(
    found: Reconstruction,
    test: SpeckleTest | None,
    likelihood: Callable[[], Likelihood],
    record: EstimateRecord | None,
) -> tuple[Doubt, ...]:
    """Return the possible faults of a reconstruction that the data can show, raised or not.

    Args:
        likelihood: returns the likelihood of the estimate before division by the camera's transfer.
        record: origin of the estimate; None for a published one.
    """
    doubts = [] if test is None else [*_doubt_light(test, record)]
    if found.posterior is not None:
        doubts.append(_doubt_samples(found.posterior, likelihood()))
    return tuple(one for one in doubts if math.isfinite(one.threshold))


def lower_confidence(found: Reconstruction, doubts: tuple[Doubt, ...], of_object: float = 1.0) -> Reconstruction:
    """Return the reconstruction with a confidence of at most `MAX_UNVERIFIED_CONFIDENCE` if a doubt is raised, and at most the probability
    that the frames show an object."""
    return replace(found, confidence=min(found.confidence, of_object, confidence_limit(doubts)))


def beside_other(found: Reconstruction, other: Reconstruction | None, probability: float) -> Reconstruction:
    """Return the reconstruction with the correlation with the truth that is expected if there is another explanation of the frames, a blur
    or none: if it holds, the truth is like the reconstruction of that.

    Args:
        probability: probability of the other explanation, given an object.
    """
    if other is None or not (found.object_found and other.object_found):
        return found
    likeness = max(aligned_pearson(other.albedo, found.albedo)[0], 0.0)
    return replace(found, confidence=found.confidence * (1.0 - probability * (1.0 - likeness)))


def confidence_limit(doubts: tuple[Doubt, ...]) -> float:
    """Return the highest confidence beside doubts, raised or not."""
    return MAX_UNVERIFIED_CONFIDENCE if any(one.is_raised for one in doubts) else 1.0


def describe_limits(
    found: Reconstruction, measurement: Measurement, estimate: Estimate, hypotheses: dict[Hypothesis, float]
) -> list[str]:
    """Describe limits set by the frames: how much light an undetected object would need, whether they may be blurred, and for which lags
    the confidence is calibrated.

    The significance of the signal is proportional to the amount of light, if the shot noise of this light sets the floor,
    and to the root of the number of frames. In 19 of 20 cases the true significance is at most two standard deviations above
    the measured one.
    """
    notes, side = [], measurement.lag_grid.object_side
    if measurement.detection < DETECTION_LIMIT:
        times = max(1.0, DETECTION_LIMIT / (max(measurement.detection, 0.0) + 2.0))
        notes.append(
            f"no signal: {measurement.detection:.1f} of the {DETECTION_LIMIT:g} standard deviations that detection needs "
            f"(probability of an object: {object_probability(hypotheses):.2g}); "
            f"if there is an object, it needs more than {times:.1f} times the light, or {times**2:.1f} times the frames"
        )
    elif not measurement.detectable:
        notes.append(
            f"a signal of {measurement.detection:.3g} standard deviations does not rise towards zero lag as r*r of an object does, so that "
            "nothing was reconstructed; check the frames, or take more"
        )
    contrast = None if estimate.record is None or estimate.blur_pixels is not None else estimate.record.contrast
    if found.object_found and contrast is not None and not contrast.is_full:
        dark = ", and take a dark frame (--dark)" if estimate.record.needs_other_light else ""
        notes.append(
            f"the contrast of the speckle is {contrast.square**0.5:.2f}: other light, a second polarisation or blur lowers it; blur "
            f"(probability {hypotheses[Hypothesis.BLURRED_OBJECT]:.2g}) would make this image wrong; check the focus{dark}"
        )
    if found.object_found and found.features is not None and side > OBJECT_SIDE:
        notes.append(
            f"the confidence is calibrated for {OBJECT_SIDE} lags; on more, here {side}, it exceeds the correlation by more than 0.24 in "
            "one of 20 cases"
        )
    return notes


def is_speckle(test: SpeckleTest | None) -> bool:
    """Return whether the third moment of frames is that of speckle, and significantly not that of texture."""
    if test is None or test.third_moment_ratio is None or test.error is None:
        return False
    return test.third_moment_ratio - 2.0 * test.error > MIN_MOMENT_RATIO and test.third_moment_ratio < MAX_MOMENT_RATIO


def _doubt_light(test: SpeckleTest, record: EstimateRecord | None) -> Iterator[Doubt]:
    """Yield the doubts whether frames are speckle of the reconstruction; none without a third moment."""
    if test.third_moment_ratio is None or test.error is None:
        return
    moment, error = float(test.third_moment_ratio), float(test.error)
    rate, width = FALSE_ALARMS_EACH, float(norm.isf(FALSE_ALARMS_EACH)) * error
    found = f"third moment {moment:.2g} +- {error:.2g} times that of speckle"
    yield Doubt(
        DoubtKind.HIGHLIGHT,
        moment,
        MAX_MOMENT_RATIO + width,
        rate,
        f"frames are inconsistent with speckle from one object ({found}); check for a specular highlight or a moving lamp",
    )
    if record is not None and record.frames == 1:
        yield _doubt_single_frame(moment, error, record)
    else:
        yield Doubt(
            DoubtKind.TEXTURE,
            moment,
            MIN_MOMENT_RATIO - width,
            rate,
            f"frames are inconsistent with speckle ({found}); check for texture of the relay wall and for saturated frames",
            is_low=True,
        )
    yield Doubt(
        DoubtKind.DIFFERENT_FRAMES,
        test.frame_differences,
        test.frame_threshold,
        rate,
        f"the frames' autocorrelations differ by {100.0 * test.frame_differences:.0f} %, which those of one object do not; "
        "check that all frames show the same object",
    )
    yield Doubt(
        DoubtKind.DIFFERENT_PARTS,
        test.part_differences,
        test.part_threshold,
        rate,
        f"the signal's power differs by {100.0 * test.part_differences:.0f} % between parts of a frame, which speckle does not; check "
        "whether these are frames of speckle",
    )
    yield Doubt(
        DoubtKind.UNEXPLAINED_SIGNAL,
        test.unexplained,
        test.unexplained_threshold,
        rate,
        f"the reconstruction leaves {100.0 * test.unexplained:.0f} % of the estimate's signal unexplained; try --quality best",
    )


def _doubt_single_frame(moment: float, error: float, record: EstimateRecord) -> Doubt:
    """Return the doubt that a single frame shows texture of the wall (third moment 0) instead of speckle (third moment 1).

    Texture must be the more probable of both, and speckle must have such a moment with a probability of at most `FALSE_ALARMS_EACH`.
    """
    prior = texture_before(record)
    error = max(error, 1e-9)
    even_odds = 0.5 - error**2 * math.log((1.0 - prior) / prior)
    limit = min(even_odds, 1.0 - float(norm.isf(FALSE_ALARMS_EACH)) * error)
    return Doubt(
        DoubtKind.TEXTURE,
        moment,
        limit,
        float(norm.cdf((limit - 1.0) / error)),
        f"one frame may show texture of the relay wall instead of an object (third moment {moment:.2g} +- {error:.2g} times that of "
        "speckle); add a frame with the spot moved",
        is_low=True,
    )


def _doubt_samples(samples: Samples, likelihood: Likelihood) -> Doubt:
    lowest = min(likelihood.misfit(torch.from_numpy(sample)) for sample in samples.samples)
    without_object = likelihood.misfit(torch.zeros(samples.samples.shape[1:]))
    return Doubt(
        DoubtKind.UNLIKELY_SAMPLES,
        lowest,
        max(MAX_DEFICIT_NATS, MAX_DEFICIT_FRACTION * without_object),
        None,
        f"no sample explains the estimate (log-likelihood deficit {lowest:.0f} nats, {without_object:.0f} without an object); "
        "probabilities and intervals are too narrow; try --quality best",
    )
