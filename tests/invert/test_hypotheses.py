"""Probabilities of the explanations of frames: those of Bayes' rule for numbers that are drawn as assumed, and for frames."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import kstest, norm

import correlograph as cg
from invert.assess.hypotheses import (
    BLUR_FOUND,
    BLUR_FOUND_FALSELY,
    PRIOR_BLURRED,
    PRIOR_OTHER_LIGHT,
    PRIOR_SHARED,
    PRIOR_WIDER,
    Hypothesis,
    blur_probability,
    describe,
    noise_probability,
    object_probability,
    texture_probability,
    weigh_hypotheses,
    wide_probability,
)
from invert.assess.reliability import beside_other, lower_confidence
from invert.measure.contrast import Contrast
from invert.measure.estimate import estimate_from_frames
from invert.measure.spectrum import Measurement, read_measurement
from invert.methods import empty_reconstruction
from radiometry.autocorrelation import autocorrelate
from radiometry.noise.detection import TRIALS
from radiometry.noise.model import draw_estimate
from tests.invert.test_doubts import FOUND, SPECKLE, kinds_raised_by, record


def is_share(found: float, cases: np.ndarray) -> bool:
    """Whether a probability is that of drawn cases, within four standard deviations and the width of a bin."""
    return abs(found - cases.mean()) < 4.0 * math.sqrt(found * (1.0 - found) / len(cases)) + 0.03


def test_the_probability_of_no_object_is_that_of_bayes():
    rng = np.random.default_rng(5)
    is_noise = rng.random(400000) < 0.5
    noise = rng.standard_normal((TRIALS, len(is_noise)))
    bright = 1000.0 ** rng.random(len(is_noise))
    seen = np.where(is_noise, noise.max(0), bright + noise[0])
    for significance in (1.05, 1.5, 2.5, 3.5):
        near = np.abs(seen - significance) < 0.05
        assert is_share(noise_probability(significance, TRIALS), is_noise[near])
    assert noise_probability(-50.0, TRIALS) == noise_probability(0.0, TRIALS) == noise_probability(1.0, TRIALS)
    assert noise_probability(math.inf, TRIALS) == 0.0
    falling = [noise_probability(significance, TRIALS) for significance in np.linspace(1.0, 12.0, 60)]
    assert np.all(np.diff(falling) < 0.0)
    assert noise_probability(6.0, TRIALS) < 1e-5


@pytest.mark.slow
def test_the_significance_of_noise_is_distributed_as_assumed(rng):
    """Frames of shot noise alone, of any size, number and light."""
    seen = []
    for _ in range(80):
        shape = rng.integers(400, 600, 2)
        frames = [rng.poisson(10.0 ** rng.uniform(-2.0, 0.0), shape).astype(np.float32) for _ in range(int(rng.choice([1, 2])))]
        estimate = estimate_from_frames(cg.Capture(frames))
        seen.append(read_measurement(estimate.values, estimate.quantisation, estimate.transfer).detection)
    # The assumed distribution may lie above the true one, which makes a faint object less probable, but not below.
    assert kstest(seen, lambda value: norm.cdf(value) ** TRIALS, alternative="less").pvalue > 0.01
    assert abs(np.quantile(seen, 0.9) - norm.ppf(0.9 ** (1.0 / TRIALS))) < 0.5


@pytest.mark.parametrize(("error", "waves", "prior"), [(0.4, 0, 0.05), (0.7, 3, 0.5)])
def test_the_probability_of_texture_is_that_of_bayes(error, waves, prior):
    """Among frames drawn as texture or speckle, the probability of those around each value is their share of texture."""
    rng = np.random.default_rng(11)
    is_texture = rng.random(200000) < prior
    moments = (~is_texture) + error * rng.standard_normal(len(is_texture))
    for moment in (-0.2, 0.1, 0.5, 1.1):
        near = np.abs(moments - moment) < 0.03
        assert is_share(
            texture_probability(replace(SPECKLE, third_moment_ratio=moment, error=error), record(1, waves)), is_texture[near]
        )
    assert texture_probability(None, record(1, waves)) == pytest.approx(prior)
    assert texture_probability(None, record(2, waves)) == 0.0


@pytest.mark.parametrize("error", [0.02, 0.3])
def test_light_that_frames_share_is_texture_if_its_contrast_is_low(error):
    """Texture has any contrast; one speckle in five has a low one, because of other light or blur."""
    rng = np.random.default_rng(12)
    is_texture, is_lowered = rng.random(400000) < PRIOR_SHARED, rng.random(400000) < PRIOR_OTHER_LIGHT + PRIOR_BLURRED
    true = np.where(is_texture | is_lowered, rng.random(len(is_texture)), 1.0)
    squares, unknown = true + error * rng.standard_normal(len(true)), replace(SPECKLE, error=math.inf)
    for square in (0.1, 0.6, 1.0):
        near = np.abs(squares - square) < 0.2 * error
        shared = record(3, shared=1.0, contrast=Contrast(square, error))
        assert is_share(texture_probability(unknown, shared), is_texture[near])
        assert texture_probability(None, shared) == 0.0
    assert texture_probability(unknown, record(3, contrast=Contrast(0.1, error))) == 0.0
    assert texture_probability(unknown, record(3, contrast=Contrast(0.1, error)), may_shake=True) > 0.5


def test_a_contrast_that_light_does_not_have_is_texture_or_processing():
    measurement = replace(read_measurement(np.pad(np.ones((3, 3), np.float32), 62) + 0.1), detection=50.0, peak=1.0)
    for square, probability in ((1.1, 0.0), (16.0, 0.5)):
        shown = record(2, contrast=Contrast(square, 0.1))
        shown.blur_found_pixels, shown.needs_other_light = None, False
        assert weigh_hypotheses(measurement, shown, None)[Hypothesis.TEXTURE] == probability


def test_a_single_frame_of_waves_without_a_third_moment_earns_no_confidence():
    unknown = replace(SPECKLE, third_moment_ratio=-30.0, error=60.0)
    probability = 1.0 - texture_probability(unknown, record(1, waves=26))
    assert kinds_raised_by(unknown, frames=1, waves=26) == []
    assert lower_confidence(FOUND, (), probability).confidence == pytest.approx(0.5, abs=0.01)


def test_the_probability_of_blur_is_that_of_bayes():
    """Eight in ten captures have contrast 1, one has other light, one is blurred."""
    rng = np.random.default_rng(7)
    kind, error = rng.choice(3, 400000, p=(0.8, 0.1, 0.1)), 0.05
    square = np.where(kind == 0, 1.0, rng.random(len(kind))) + error * rng.standard_normal(len(kind))
    is_found = rng.random(len(kind)) < np.where(kind == 2, BLUR_FOUND, BLUR_FOUND_FALSELY)
    for value in (0.4, 0.7, 0.84, 0.97, 1.05):
        near = np.abs(square - value) < 0.01
        assert is_share(blur_probability(Contrast(value, error), False), kind[near] == 2)
        if value < 0.9:
            assert is_share(blur_probability(Contrast(value, error), True), kind[near & is_found] == 2)
    assert blur_probability(None, False) == pytest.approx(0.1)
    assert blur_probability(Contrast(0.1, error), False, needs_other_light=True) == pytest.approx(0.1)


def test_confidence_is_the_correlation_expected_over_both_explanations():
    """One capture in four is blurred; its truth is like the other reconstruction."""
    wide = np.zeros((64, 64), np.float32)
    wide[20:40, 10:50] = 1.0
    narrow = np.pad(wide[20:40, 20:40], 22)
    found, other = (replace(FOUND, albedo=albedo, confidence=0.8) for albedo in (wide, narrow))
    likeness = np.corrcoef(wide.ravel(), np.roll(narrow, -2, (0, 1)).ravel())[0, 1]
    assert beside_other(found, other, 0.25).confidence == pytest.approx(0.8 * (0.75 + 0.25 * likeness), abs=0.02)
    assert beside_other(found, None, 0.25) == beside_other(found, empty_reconstruction(64), 0.25) == found


def test_probabilities_of_frames_add_up_and_are_told(rng):
    """A frame of speckle without blur, and frames of noise."""
    field = np.fft.ifft2(np.exp(2j * np.pi * rng.random((600, 660))) * (np.hypot(*np.indices((600, 660))) < 40.0))
    frames = [rng.poisson(np.abs(field) ** 2 / np.mean(np.abs(field) ** 2)).astype(np.float32)]
    result = cg.reconstruct(np.array(frames), quality="fast")
    assert sum(result.hypotheses.values()) == pytest.approx(1.0)
    assert result.hypotheses[Hypothesis.OBJECT] > 0.5
    assert result.confidence <= object_probability(result.hypotheses)
    assert describe(result.hypotheses).startswith("probabilities: object ")
    empty = cg.reconstruct(rng.poisson(0.3, (2, 500, 540)).astype(np.float32), quality="fast")
    assert empty.hypotheses[Hypothesis.NO_OBJECT] > 0.5
    assert "probability of an object: 0." in empty.notes[-1]


def test_a_signal_that_does_not_rise_towards_zero_lag_is_no_object(rng):
    flat = replace(read_measurement(np.abs(rng.standard_normal((127, 127))).astype(np.float32)), detection=50.0, peak=-1.0)
    assert weigh_hypotheses(flat, None, None)[Hypothesis.NO_OBJECT] == 1.0


def test_a_few_photons_are_no_object(rng):
    """One bright pixel in each of three frames, and one photon in a small frame: no statistics, although every lag is known exactly."""
    frames = np.zeros((3, 300, 340), np.float32)
    for frame in frames:
        frame[tuple(rng.integers(300, size=2))] = 1e4
    single = np.zeros((200, 260), np.float32)
    single[120, 77] = 1.0
    for shown in (frames, single):
        result = cg.reconstruct(shown, quality="fast")
        assert not result.object_found
        assert result.hypotheses[Hypothesis.NO_OBJECT] > 0.9
        assert any("expose longer" in note for note in result.notes)


def test_a_published_estimate_has_two_explanations(rng):
    measurement = read_measurement(np.abs(rng.standard_normal((127, 127))).astype(np.float32))
    found = weigh_hypotheses(measurement, None, None)
    assert found[Hypothesis.TEXTURE] == found[Hypothesis.BLURRED_OBJECT] == 0.0


@pytest.mark.parametrize(("significance", "least", "most"), [(6.0, 0.5, 0.95), (8.0, 0.9999, 1.0), (None, 0.0, 0.0)])
def test_motion_is_as_probable_as_it_is_significant(significance, least, most, rng):
    """At six standard deviations, one in a million displacements of noise may have reached it."""
    measurement = read_measurement(np.abs(rng.standard_normal((127, 127))).astype(np.float32))
    measurement = replace(measurement, detection=50.0, peak=1.0)
    found = weigh_hypotheses(measurement, None, None, significance)
    assert sum(found.values()) == pytest.approx(1.0)
    assert least <= found[Hypothesis.MOVING_OBJECT] <= most
    assert object_probability(found) == pytest.approx(1.0)


def measured_bar(width: float, floor: float, dof: float) -> Measurement:
    """A slanted bar, 20 lags high; floor in units of the peak."""
    row, column = np.mgrid[:256, :256] - 128.0
    bar = (np.abs(row + 0.3 * column) < 10.0) & (np.abs(column - 0.3 * row) < width / 2.0)
    signal = torch.from_numpy(autocorrelate(bar.astype(np.float64))[192:319, 192:319])
    noise = torch.Generator().manual_seed(3)
    return read_measurement(draw_estimate(signal + floor * signal.max(), dof, noise, correlated=True).numpy())


def test_an_object_is_as_probably_wide_as_its_correlations_reach_far():
    narrow, wide = (wide_probability(measured_bar(width, 0.1, 3000.0)) for width in (24.0, 120.0))
    assert narrow < 1e-6
    assert 0.7 < wide < wide_probability(measured_bar(120.0, 0.1, 3000.0), prior=0.5)


def test_noise_hides_how_wide_an_object_is():
    sharp, noisy = (wide_probability(measured_bar(56.0, floor, 300.0)) for floor in (0.1, 10.0))
    assert sharp < 0.01 < PRIOR_WIDER < noisy < 0.2
    assert wide_probability(measured_bar(120.0, 10.0, 10.0)) == pytest.approx(PRIOR_WIDER)  # nothing is detected


def test_a_published_estimate_that_fills_its_lags_has_a_warning():
    found = cg.reconstruct(measured_bar(120.0, 0.1, 3000.0).values, quality="fast")
    assert found.hypotheses[Hypothesis.WIDE_OBJECT] > 0.7
    assert "the object may be wider than the lags; take more lags" in found.warnings
