"""Reliability of a reconstruction: lower confidence if the data do not support it, and warnings about the frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from scipy.special import expit

from correlograph.lags import OBJECT_SIDE
from invert.albedo.posterior import Samples
from invert.assess.speckle_test import SpeckleTest
from invert.likelihood.gamma import Likelihood
from invert.measure.estimate import EstimateRecord
from invert.measure.patch_fit import is_wider_than_lags
from invert.measure.spectrum import Measurement
from invert.methods import Reconstruction
from radiometry.noise.detection import DETECTION_LIMIT

MAX_UNVERIFIED_CONFIDENCE = 0.5
"""Maximum confidence if the light may not be speckle of the object, or if the reconstruction does not explain the estimate."""

MIN_MOMENT_RATIO, MAX_MOMENT_RATIO = 0.25, 1.3
"""Range of the third moment, in units of that of speckle. Texture lies below it; specular highlights lie above it."""

PRIOR_TEXTURE, PRIOR_WITH_WAVES = 0.05, 0.5
"""Probability, before its third moment is known, that the signal of a single frame comes from texture of the relay wall or of the
sensor; the second number holds if periodic waves were found."""

MAX_PART_CHANCE, MAX_PART_DIFFERENCES = 1e-6, 0.25
"""Limits (chance, difference) beyond which parts of a frame are not speckle. Uneven light explains smaller differences."""

MAX_FRAME_CHANCE, MAX_FRAME_DIFFERENCES = 1e-4, 0.1
"""Limits (chance, difference) beyond which frames do not show one object at rest. Errors of the noise model and changes of focus
explain smaller differences."""

MAX_UNEXPLAINED_FRACTION = 0.35
"""Maximum fraction of the signal that a reconstruction may leave unexplained with a probability of 99 %."""

MAX_DEFICIT_NATS, MAX_DEFICIT_FRACTION = 100.0, 0.04
"""Maximum log-likelihood deficit of the most likely sample, in nats and as a fraction of the deficit without an object. Evidence:
docs/research.md."""

MAX_SATURATED_FRACTION = 1e-3
"""Maximum fraction of saturated pixels without a note."""

MAX_FRAME_CORRELATION = 0.3
"""Maximum correlation of frames without a note; correlated frames lower K."""

MAX_SHIFT_PIXELS = 0.2
"""Maximum shift of the camera between frames without a note; the estimate corrects it."""

MAX_PATTERN_FRACTION = 0.1
"""Maximum fraction of lags at which a static pattern is subtracted without a note."""


def assess_reliability(
    found: Reconstruction,
    test: SpeckleTest | None,
    measurement: Measurement,
    likelihood: Callable[[], Likelihood],
    record: EstimateRecord | None,
) -> tuple[Reconstruction, list[str]]:
    """Lower the confidence of a reconstruction that the data do not support; return it and the warnings.

    Args:
        likelihood: returns the likelihood of the estimate before division by the camera's transfer.
        record: origin of the estimate; None for a published one.
    """
    doubts = [] if test is None or test.third_moment_ratio is None else _check_speckle(test, record)
    if found.posterior is not None:
        doubts += _check_samples(found.posterior, likelihood())
    warnings = doubts + ([] if record is None else _describe_frames(record, measurement))
    return (replace(found, confidence=min(found.confidence, MAX_UNVERIFIED_CONFIDENCE)) if doubts else found), warnings


def describe_limits(found: Reconstruction, measurement: Measurement) -> list[str]:
    """Describe limits set by the frames: how much light an undetected object would need, and for which lags the confidence
    is calibrated.

    The significance of the signal is proportional to the amount of light, if the shot noise of this light sets the floor,
    and to the root of the number of frames. In 19 of 20 cases the true significance is at most two standard deviations above
    the measured one.
    """
    notes, side = [], measurement.lag_grid.object_side
    if measurement.detection < DETECTION_LIMIT:
        times = max(1.0, DETECTION_LIMIT / (max(measurement.detection, 0.0) + 2.0))
        notes.append(
            f"no signal: {measurement.detection:.1f} of the {DETECTION_LIMIT:g} standard deviations that detection needs; "
            f"if there is an object, it needs more than {times:.1f} times the light, or {times**2:.1f} times the frames"
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


def _check_speckle(test: SpeckleTest, record: EstimateRecord | None) -> list[str]:
    moment, error = test.third_moment_ratio or 0.0, 2.0 * (test.error or 0.0)
    found = f"third moment {moment:.2g} +- {0.5 * error:.2g} times that of speckle"
    if moment - error > MAX_MOMENT_RATIO:
        return [
            f"frames are inconsistent with speckle from one object ({found}); check for a specular highlight or a moving lamp"
        ]
    if moment + error < MIN_MOMENT_RATIO:
        return [f"frames are inconsistent with speckle ({found}); check for texture of the relay wall and for saturated frames"]
    if test.frame_chance < MAX_FRAME_CHANCE and test.frame_differences > MAX_FRAME_DIFFERENCES:
        return [
            f"the frames' autocorrelations differ by {100.0 * test.frame_differences:.0f} %, which those of one object do not; "
            "check that all frames show the same object"
        ]
    if test.part_chance < MAX_PART_CHANCE and test.part_differences > MAX_PART_DIFFERENCES:
        return [
            f"the signal's power differs by {100.0 * test.part_differences:.0f} % between parts of a frame, which speckle does not; check "
            "whether these are frames of speckle"
        ]
    if test.unexplained_least > MAX_UNEXPLAINED_FRACTION:
        return [f"the reconstruction leaves {100.0 * test.unexplained:.0f} % of the estimate's signal unexplained"]
    if record is not None and record.frames == 1 and _texture_probability(moment, test.error or 0.0, record) > 0.5:
        return [f"one frame may show texture of the relay wall instead of an object ({found}); add a frame with the spot moved"]
    return []


def _texture_probability(moment: float, error: float, record: EstimateRecord) -> float:
    """Return the probability that a single frame shows wall texture (third moment 0) instead of speckle (third moment 1)."""
    prior = PRIOR_WITH_WAVES if record.background.spectral_lines else PRIOR_TEXTURE
    if not 0.0 < error < math.inf:
        return prior if error else float(abs(moment) < 0.5)
    lead = 0.5 * ((moment - 1.0) ** 2 - moment**2) / error**2 + math.log(prior / (1.0 - prior))
    return float(expit(lead))


def _check_samples(samples: Samples, likelihood: Likelihood) -> list[str]:
    lowest = min(likelihood.misfit(torch.from_numpy(sample)) for sample in samples.samples)
    without_object = likelihood.misfit(torch.zeros(samples.samples.shape[1:]))
    if lowest <= max(MAX_DEFICIT_NATS, MAX_DEFICIT_FRACTION * without_object):
        return []
    return [
        f"no sample explains the estimate (log-likelihood deficit {lowest:.0f} nats, {without_object:.0f} without an object); "
        "probabilities and intervals are too narrow; try --quality best"
    ]


def has_shifted(record: EstimateRecord | None) -> bool:
    """Return whether the pattern that frames share moved between them."""
    shift = (record and record.background.shift_pixels) or (0.0, 0.0)
    return max(map(abs, shift)) > MAX_SHIFT_PIXELS


def _describe_frames(record: EstimateRecord, measurement: Measurement) -> list[str]:
    """Describe the background and the sensor faults that the estimator found and corrected."""
    found = record.background
    shared, saturated = found.frames_correlate or 0.0, found.saturated or 0.0
    pattern, shift = found.fixed_pattern_lags or 0.0, found.shift_pixels or (0.0, 0.0)
    remarks = [
        (
            shared > MAX_FRAME_CORRELATION,
            f"frames correlate by {100.0 * shared:.0f} %; move the laser spot between frames",
        ),
        (saturated > MAX_SATURATED_FRACTION, f"{100.0 * saturated:.2g} % of the pixels are saturated; shorten the exposure"),
        (bool(found.hot_pixels), f"{found.hot_pixels} hot pixels or pixels of specular highlights were replaced"),
        (bool(found.faulty_lines), f"{found.faulty_lines} defective rows or columns were replaced by their neighbours"),
        (bool(found.spectral_lines), f"{found.spectral_lines} periodic waves (fringes or lamp flicker) were subtracted"),
        (
            has_shifted(record),
            f"the camera shifted by {shift[0]:.1f} rows and {shift[1]:.1f} columns between frames; fix its mount",
        ),
        (
            record.frames > 1 and pattern > MAX_PATTERN_FRACTION,
            f"frames share a static pattern, which was subtracted at {100.0 * pattern:.0f} % of the lags",
        ),
    ]
    warnings = [text for is_present, text in remarks if is_present]
    if record.blur_found_pixels is not None:
        rows, columns = record.blur_found_pixels
        warnings.append(
            f"frames look blurred by {rows:.1f} rows and {columns:.1f} columns, unless the object has soft edges; the blur was "
            "deconvolved; check focus and motion, or set --blur-pixels (0 for no blur)"
        )
    if is_wider_than_lags(measurement):
        warnings.append("the object may be wider than the lags; try --patch fit, or frames with smaller pixels")
    return warnings
