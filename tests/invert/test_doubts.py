"""Doubts about a reconstruction: thresholds with a stated rate of false alarms, and what they say."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter
from scipy.stats import f as f_distribution
from scipy.stats import norm

import correlograph as cg
from invert.assess.doubts import FALSE_ALARMS, FALSE_ALARMS_EACH, Doubt, DoubtKind
from invert.assess.reliability import find_doubts, lower_confidence
from invert.assess.speckle_test import SpeckleTest
from invert.measure.contrast import Contrast
from invert.methods import Reconstruction
from radiometry.estimation.excess_scatter import ExcessScatter
from tests.invert.field.speckle import expected_frame, letter, travelling_frames

SPECKLE = SpeckleTest(0.97, 0.05, 0.1, 0.36, 0.05, 0.3, 0.02, 0.12)
FOUND = Reconstruction(np.ones((64, 64), np.float32), True, 0.9, None)


def record(frames: int, waves: int = 0, shared: float = 0.0, contrast: Contrast | None = None) -> SimpleNamespace:
    """Return what the doubts read of the origin of an estimate."""
    background = SimpleNamespace(spectral_lines=waves, fixed_pattern_lags=shared)
    return SimpleNamespace(frames=frames, background=background, contrast=contrast)


def doubts_of(test: SpeckleTest | None, frames: int = 2, waves: int = 0) -> tuple[Doubt, ...]:
    return find_doubts(FOUND, test, lambda: pytest.fail("no samples, no likelihood"), record(frames, waves))


def kinds_raised_by(*args, **options) -> list[DoubtKind]:
    return [one.kind for one in doubts_of(*args, **options) if one.is_raised]


@pytest.mark.parametrize("allowed", [0.0, 0.25])
def test_thresholds_of_scatter_are_exceeded_at_their_rate(allowed):
    """Means of groups that differ by chance and by an allowed amount, against the scatter within the groups."""
    rng = np.random.default_rng(5)
    trials, groups, members, rate = 6000, 7, 4, 0.03
    true = rng.normal(scale=allowed, size=(trials, groups, 1))
    values = 1.0 + true + 0.6 * rng.standard_normal((trials, groups, members))
    within = values.var(2, ddof=1).mean(1) / members
    between = values.mean(2).var(1, ddof=1)
    null = f_distribution(groups - 1, groups * (members - 1))
    scatter = [ExcessScatter.of(*pair, null) for pair in zip(between, within, strict=True)]
    exceeded = np.mean([one.relative > one.threshold(allowed, rate) for one in scatter])
    chance = math.sqrt(rate * (1.0 - rate) / trials)
    if allowed == 0.0:
        assert exceeded == pytest.approx(rate, abs=4.0 * chance)
    else:  # the error of the measured scatter by chance counts less than F assumes
        assert exceeded < rate + 4.0 * chance
        assert exceeded > 0.2 * rate


def test_speckle_raises_no_doubt():
    assert kinds_raised_by(SPECKLE) == kinds_raised_by(SPECKLE, frames=1) == []
    assert lower_confidence(FOUND, doubts_of(SPECKLE)).confidence == 0.9


@pytest.mark.parametrize(
    ("changes", "frames", "kind"),
    [
        ({"third_moment_ratio": 1.6}, 2, DoubtKind.HIGHLIGHT),
        ({"third_moment_ratio": 0.05}, 2, DoubtKind.TEXTURE),
        ({"third_moment_ratio": 0.3}, 1, DoubtKind.TEXTURE),
        ({"frame_differences": 0.13}, 2, DoubtKind.DIFFERENT_FRAMES),
        ({"part_differences": 0.31}, 2, DoubtKind.DIFFERENT_PARTS),
        ({"unexplained": 0.4}, 2, DoubtKind.UNEXPLAINED_SIGNAL),
    ],
)
def test_each_fault_raises_its_doubt_alone(changes, frames, kind):
    found = doubts_of(replace(SPECKLE, **changes), frames)
    assert [one.kind for one in found if one.is_raised] == [kind]
    assert lower_confidence(FOUND, found).confidence == 0.5


def test_uncertain_third_moments_raise_no_doubt():
    for ratio in (0.0, 2.0):
        assert kinds_raised_by(replace(SPECKLE, third_moment_ratio=ratio, error=0.9)) == []
        assert kinds_raised_by(replace(SPECKLE, third_moment_ratio=ratio, error=0.9), frames=1) == []
    assert kinds_raised_by(replace(SPECKLE, third_moment_ratio=-0.2, error=0.3), frames=1) == [DoubtKind.TEXTURE]


@pytest.mark.parametrize("error", [0.02, 0.15, 0.3, 0.5, 1.0])
@pytest.mark.parametrize("waves", [0, 3])
def test_false_alarms_of_a_single_frame_are_as_stated(error, waves):
    (doubt,) = (one for one in doubts_of(replace(SPECKLE, error=error), 1, waves) if one.kind is DoubtKind.TEXTURE)
    assert doubt.false_alarms == pytest.approx(norm.cdf(doubt.threshold, 1.0, error))
    assert doubt.false_alarms <= FALSE_ALARMS_EACH * (1.0 + 1e-6)


def test_missing_measurements_raise_no_doubt():
    """A published autocorrelation has no third moment; a single frame has no other frames."""
    assert doubts_of(None) == doubts_of(SpeckleTest(None, None, 0.9)) == ()
    assert DoubtKind.DIFFERENT_FRAMES not in [one.kind for one in doubts_of(replace(SPECKLE, frame_threshold=math.inf), 1)]
    assert doubts_of(replace(SPECKLE, error=math.inf))[0].kind is DoubtKind.DIFFERENT_FRAMES


def test_the_budget_is_divided_among_the_kinds():
    rates = [one.false_alarms for one in doubts_of(SPECKLE)]
    assert sum(rates) <= FALSE_ALARMS
    assert len({one.kind for one in doubts_of(SPECKLE)}) == len(rates) == len(DoubtKind) - 2


def test_doubts_survive_json():
    for one in doubts_of(replace(SPECKLE, third_moment_ratio=0.01)):
        written = json.loads(json.dumps(one.as_dict(), allow_nan=False))
        assert Doubt.from_dict(written) == one
        assert written["raised"] is one.is_raised


def test_a_contrast_that_light_cannot_have_is_named(rng):
    """Frames that a camera sharpened: each pixel and twice its difference from its neighbours."""
    frames = [rng.poisson(30.0 * expected_frame(letter(64, 28), (300, 340), 128, rng)).astype(np.float32) for _ in range(3)]
    sharpened = [one + 2.0 * (one - uniform_filter(one, 5)) for one in frames]
    told = [cg.reconstruct(cg.Capture(some), quality="fast", patch=128, lags=63).warnings for some in (frames, sharpened)]
    assert ["higher than light makes it" in " ".join(one) for one in told] == [False, True]


@pytest.mark.parametrize(
    ("step", "open_share", "is_blurred"), [((8.0, -12.0), 1.0, True), ((8.0, -12.0), 0.02, False), ((0.0, 0.0), 1.0, False)]
)
def test_motion_during_the_exposure_is_named(step, open_share, is_blurred, rng):
    """Four instants of each exposure. Without the doubt, the confidence of the first image is 0.9 at a correlation of 0.5."""
    instants = np.arange(16)[:, None] + open_share * (np.arange(4) + 0.5) / 4.0
    path = instants.reshape(-1, 1) * np.array(step)
    seen = np.array(travelling_frames(letter(64, 28), (300, 340), 128, rng, path, 240.0)).reshape(16, 4, 300, 340).mean(1)
    frames = [rng.poisson(0.5 * frame).astype(np.float32) for frame in seen]
    found = cg.reconstruct(cg.Capture(frames), quality="fast", patch=128, lags=63)
    raised = [one.kind for one in found.doubts if one.is_raised]
    assert (DoubtKind.MOTION_BLUR in raised) == is_blurred
    assert found.confidence <= 0.5 or not is_blurred
