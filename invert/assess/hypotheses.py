"""Probabilities of the explanations of frames: no object, texture instead of speckle, an object that moves, one wider than the lags, a
sharp one, or a blurred one.

Each number decides one question, by Bayes' rule with stated probabilities before it is known. The significance of the signal decides
whether there is any light of an object; the third moment, and the contrast of frames that share light, whether that light is speckle; the
significance of a common motion, whether the object moves while the laser is at rest; the extent of r*r, whether the object is wider than
the lags; the contrast of the speckle and the search for a blur, whether it is blurred.
"""

from __future__ import annotations

import math
from enum import Enum

import numpy as np
from scipy.special import expit
from scipy.stats import norm

from invert.assess.speckle_test import SpeckleTest
from invert.measure.contrast import Contrast
from invert.measure.estimate import EstimateRecord
from invert.measure.patch_fit import signal_extent_lags
from invert.measure.spectrum import Measurement
from radiometry.noise.detection import DETECTION_LIMIT, TRIALS

PRIOR_NO_OBJECT = 0.5
"""Probability, before the frames are known, that there is no object."""

MAX_SIGNIFICANCE = 1e3
"""The significance of an object lies between 1 and this before it is known, on a logarithmic scale."""

SHIFTS = 10**6
"""Number of independent displacements of frames, at most: the highest cross-correlation of noise is that of so many normal variables."""

PRIOR_TEXTURE, PRIOR_WITH_WAVES = 0.05, 0.5
"""Probability, before its third moment is known, that the signal of a single frame comes from texture of the relay wall or of the
sensor; the second number holds if periodic waves were found."""

PRIOR_SHARED = 0.3
"""The same for several frames that share light at nearly all lags, which leaves texture if the level of a lamp changes, and for few frames
whose light moves, as with a camera that shakes."""

PRIOR_TOO_HIGH = 0.5
"""The same at least, if the contrast is higher than light makes it: frames of an object that were sharpened have such a contrast, too."""

MIN_SHARED_LAGS = 0.9
"""Fraction of the lags above which frames share light at nearly all of them."""

PRIOR_BLURRED, PRIOR_OTHER_LIGHT = 0.1, 0.1
"""Probabilities, before the contrast is known, that frames are blurred, and that other light or a second polarisation lowers their
contrast instead. Either lowers its square to any value between 0 and 1 with equal probability."""

PRIOR_WIDER = 0.1
"""Probability, before the extent of r*r is known, that the object is wider than the lags."""

WIDE_EXTENT, WIDE_EXTENT_NOISE = 0.84, 1.25
"""Extent of r*r, as a fraction of the lags, that as many objects have that are wider than these as objects that are not, if both are as
frequent; and by how much less it is in noise, times the root of the significance. Evidence: docs/research.md, "Width and extent"."""

EXTENT_SCATTER, EXTENT_SCATTER_NOISE = 0.02, 0.45
"""Scatter of this extent as a logistic scale, and how it grows in noise. Evidence: the same."""

BLUR_FOUND, BLUR_FOUND_FALSELY = 0.3, 0.02
"""Rates at which the search finds a blur of half a pixel to five, and one in sharp frames of low contrast. Evidence: docs/research.md,
"Unknown blur"."""


class Hypothesis(Enum):
    """Explanation of frames."""

    NO_OBJECT = "no object"
    TEXTURE = "texture"
    MOVING_OBJECT = "moving object"
    WIDE_OBJECT = "object wider than the lags"
    OBJECT = "object"
    BLURRED_OBJECT = "blurred object"


def weigh_hypotheses(
    measurement: Measurement,
    record: EstimateRecord | None,
    test: SpeckleTest | None,
    motion: float | None = None,
    *,
    may_shake: bool = False,
) -> dict[Hypothesis, float]:
    """Return the probability of each hypothesis; they add up to 1.

    Args:
        record: origin of the estimate; None for a published one, which cannot show texture or blur.
        motion: significance of the motion of the speckle; None if none was found.
        may_shake: whether the motion between frames may be that of a camera that shakes.
    """
    none = noise_probability(measurement.detection, TRIALS)
    if measurement.detection >= DETECTION_LIMIT and measurement.peak <= 0.0:  # r*r of any object rises towards zero lag
        none = 1.0
    texture = 0.0 if record is None else texture_probability(test, record, may_shake=may_shake)
    if record is not None and record.contrast is not None and record.contrast.is_too_high:
        texture = max(texture, PRIOR_TOO_HIGH)
    blur = (
        0.0
        if record is None
        else blur_probability(record.contrast, record.blur_found_pixels is not None, needs_other_light=record.needs_other_light)
    )
    speckle = (1.0 - none) * (1.0 - texture)
    moving = 0.0 if motion is None else speckle * (1.0 - noise_probability(motion, SHIFTS))
    speckle -= moving
    wide = speckle * wide_probability(measurement)
    speckle -= wide
    return {
        Hypothesis.NO_OBJECT: none,
        Hypothesis.TEXTURE: (1.0 - none) * texture,
        Hypothesis.MOVING_OBJECT: moving,
        Hypothesis.WIDE_OBJECT: wide,
        Hypothesis.OBJECT: speckle * (1.0 - blur),
        Hypothesis.BLURRED_OBJECT: speckle * blur,
    }


def object_probability(hypotheses: dict[Hypothesis, float]) -> float:
    """Return the probability of an object, at rest or moving, of any width, sharp or blurred."""
    return 1.0 - hypotheses[Hypothesis.NO_OBJECT] - hypotheses[Hypothesis.TEXTURE]


def blurred_share(hypotheses: dict[Hypothesis, float]) -> float:
    """Return the probability that frames are blurred if they show a resting object no wider than the lags."""
    sharp, blurred = hypotheses[Hypothesis.OBJECT], hypotheses[Hypothesis.BLURRED_OBJECT]
    return blurred / (sharp + blurred) if sharp + blurred > 0.0 else 0.0


def describe(hypotheses: dict[Hypothesis, float]) -> str:
    """Return the hypotheses with more than a thousandth, the most probable first, in words."""
    ranked = sorted(hypotheses.items(), key=lambda one: -one[1])
    return "probabilities: " + ", ".join(f"{one.value} {probability:.3g}" for one, probability in ranked if probability > 1e-3)


def noise_probability(significance: float, trials: int) -> float:
    """Return the probability that a signal of some significance is noise.

    It is the highest of a number of normal variables without an object, and that of the object, plus one normal variable, otherwise.
    """
    if significance > 30.0:
        return 0.0
    significance = max(significance, 1.0)  # less is no evidence of an object, although the highest of several rarely is so low
    possible = np.geomspace(1.0, MAX_SIGNIFICANCE, 400)
    of_object = float(norm.pdf(significance, possible).mean())
    of_noise = float(trials * norm.pdf(significance) * norm.cdf(significance) ** (trials - 1))
    odds = PRIOR_NO_OBJECT * of_noise, (1.0 - PRIOR_NO_OBJECT) * of_object
    return odds[0] / sum(odds)


def texture_probability(test: SpeckleTest | None, record: EstimateRecord, *, may_shake: bool = False) -> float:
    """Return the probability that frames show texture, whose third moment is 0 in the unit of that of speckle; 0 for several frames that
    share no light, or whose third moment was not measured. The contrast of texture has any value below 1."""
    moment = None if test is None or test.error is None else test.third_moment_ratio
    if record.frames == 1:
        prior, (full, lowered) = texture_before(record), (1.0, 1.0)
    elif moment is not None and ((record.background.fixed_pattern_lags or 0.0) > MIN_SHARED_LAGS or may_shake):
        prior, (full, lowered) = PRIOR_SHARED, contrast_evidence(record.contrast)
    else:
        return 0.0
    sharp = 1.0 - PRIOR_BLURRED - PRIOR_OTHER_LIGHT
    odds = prior * lowered / ((1.0 - prior) * max(sharp * full + (1.0 - sharp) * lowered, 1e-300))
    if moment is None or not math.isfinite(test.error):
        return odds / (1.0 + odds)
    log_odds = math.log(max(odds, 1e-300)) - (float(moment) - 0.5) / max(float(test.error), 1e-9) ** 2
    return float(expit(log_odds))


def contrast_evidence(contrast: Contrast | None) -> tuple[float, float]:
    """Return the probability density of a squared contrast if the true one is 1, and if it has any value between 0 and 1."""
    if contrast is None:
        return 1.0, 1.0
    error = max(contrast.error, 1e-6)
    return float(norm.pdf(contrast.square, 1.0, error)), float(norm.sf(contrast.square, 1.0, error))


def texture_before(record: EstimateRecord) -> float:
    """Return the probability of texture in a single frame before its third moment is known."""
    return PRIOR_WITH_WAVES if record.background.spectral_lines else PRIOR_TEXTURE


def wide_probability(measurement: Measurement, prior: float = PRIOR_WIDER) -> float:
    """Return the probability that an object is wider than the lags; without a detected signal, that before.

    Args:
        prior: the probability before the extent of r*r is known.
    """
    log_odds = math.log(prior / (1.0 - prior))
    if measurement.detectable:
        noise = measurement.detection**-0.5
        extent = signal_extent_lags(measurement) / measurement.lag_grid.object_side
        log_odds += (extent - WIDE_EXTENT + WIDE_EXTENT_NOISE * noise) / (EXTENT_SCATTER + EXTENT_SCATTER_NOISE * noise)
    return float(expit(log_odds))


def blur_probability(contrast: Contrast | None, is_found: bool, *, needs_other_light: bool = False) -> float:
    """Return the probability that frames are blurred. A search that finds no blur says nothing: soft edges explain many blurs as well.

    Args:
        contrast: contrast of the speckle; None if unknown.
        is_found: whether a blur was found.
        needs_other_light: whether no possible blur lowers the contrast so far; then there is other light, blurred or not.
    """
    sharp, other, blur = 1.0 - PRIOR_BLURRED - PRIOR_OTHER_LIGHT, PRIOR_OTHER_LIGHT, PRIOR_BLURRED
    full, lowered = contrast_evidence(contrast)
    sharp, other, blur = sharp * full, other * lowered, blur * lowered
    if needs_other_light:
        sharp, other, blur = 0.0, 1.0 - PRIOR_BLURRED, PRIOR_BLURRED
    if is_found:
        sharp, other, blur = sharp * BLUR_FOUND_FALSELY, other * BLUR_FOUND_FALSELY, blur * BLUR_FOUND
    total = sharp + other + blur
    return blur / total if total > 0.0 else 0.0
