"""Steps of an object that moves while the shutter is open, against the intensities of drawn fields."""

from __future__ import annotations

import numpy as np
import pytest

from invert.tracking.band import Band
from invert.tracking.follow import Followed
from invert.tracking.shutter import for_open_shutter, shortening
from invert.tracking.smoothing import PathNoise
from radiometry.motion import airy


def narrow_band(frequency: float = 0.002) -> Band:
    """A band around one frequency along the rows, at which phases are small."""
    return Band((64, 64), np.array([-frequency, frequency]), np.zeros(1), np.ones((2, 1)), np.ones((2, 1)), 1.0, 1.0)


def seen_path(steps: np.ndarray, factor: np.ndarray, fading: float) -> Followed:
    """A path whose steps (n, 2) appear shorter by a factor (n,)."""
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(factor[:, None] * steps, 0)])
    return Followed(path, np.zeros_like(path), 1, np.ones((2, 1)), fading=fading, noise=PathNoise(np.full(2, 0.5e-8)))


@pytest.mark.parametrize(("fading", "share"), [(0.1, 1.0), (0.5, 0.6), (0.9, 1.0)])
def test_exposures_of_drawn_fields_move_by_the_shortened_step(rng, fading, share):
    """Waves whose amplitudes change as under a round spot travel by 0.7 cells per interval. The intensities of two exposures have a
    cross-spectrum whose phase is that of the integral."""
    waves, step, moments, draws = 16, 0.7, 12, 1500
    times = (np.arange(moments) + 0.5) / moments * share
    times = np.concatenate([times, 1.0 + times])
    alike = airy(2.0 * fading**0.5 * np.abs(times[:, None] - times))
    values, vectors = np.linalg.eigh(alike)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    turns = np.arange(waves) / (2 * waves)
    amplitudes = root @ (rng.normal(size=(draws, len(times), waves)) + 1j * rng.normal(size=(draws, len(times), waves)))
    amplitudes = amplitudes * np.exp(-2j * np.pi * step * times[:, None] * turns)
    intensity = np.abs(np.fft.ifft(amplitudes, 2 * waves)) ** 2
    spectra = np.fft.rfft(intensity.reshape(draws, 2, moments, -1).mean(2))
    cross = (spectra[:, 1] * spectra[:, 0].conj()).mean(0)
    phase = 2.0 * np.pi * step * np.arange(2, 9) / (2 * waves)
    found = -np.angle(cross[2:9]) / phase
    expected = shortening(np.full(7, fading), phase, share)
    np.testing.assert_allclose(found.mean(), expected.mean(), atol=0.012)
    assert expected.mean() < 1.0 - 0.8 * fading * share**2 / 3.0


def test_little_fading_shortens_by_its_third():
    found = shortening(np.array([1e-3, 0.02]), np.array([0.1, 0.1]), 0.5)
    np.testing.assert_allclose(found, 1.0 - np.array([1e-3, 0.02]) * 0.25 / 3.0, rtol=1e-4)


@pytest.mark.parametrize("share", [0.5, 1.0])
@pytest.mark.parametrize("fading", [0.1, 0.3, 0.6])
def test_a_gaussian_spot_is_within_the_stated_error(fading, share):
    """Likenesses exp(-fading k^2) of all instants of two exposures: their mean, and the mean distance that they weight."""
    apart = np.linspace(-1.0, 1.0, 2001)
    alike = (1.0 - np.abs(apart)) * np.exp(-fading * (1.0 + share * apart) ** 2)
    factor = float((alike * (1.0 + share * apart)).sum() / alike.sum())
    steps = np.tile([3.0, -2.0], (4, 1))
    corrected = for_open_shutter(seen_path(steps, np.full(4, factor), fading), narrow_band(), share)
    truth = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)])
    np.testing.assert_allclose(corrected.path, truth, rtol=0.05)
    np.testing.assert_array_less(np.abs(corrected.path - truth)[1:], corrected.error[1:])


def test_fast_steps_are_shortened_more():
    """Fading is proportional to the square of the step: with 0.02 for a pixel, three pixels have 0.18."""
    steps = np.array([[1.0, 0.0]] * 4 + [[0.0, 3.0]] * 4)
    factor = shortening(np.repeat([0.02, 0.18], 4), np.full(8, 0.1), 1.0)
    squares = ((factor[:, None] * steps) ** 2).sum(1)
    usual = 0.02 * squares.mean()  # that of the mean square of the steps as they appear
    truth = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)])
    found = for_open_shutter(seen_path(steps, factor, usual), narrow_band(), 1.0)
    np.testing.assert_allclose(found.path, truth, rtol=0.01, atol=0.01)
    assert found.shortened == pytest.approx(1.0 - factor.min(), rel=0.1)


def test_a_closed_shutter_changes_nothing():
    seen = seen_path(np.array([[1.0, 2.0], [3.0, 1.0]]), np.ones(2), 0.4)
    found = for_open_shutter(seen, narrow_band(), 0.0)
    np.testing.assert_array_equal(found.path, seen.path)
    assert found.shortened == 0.0
