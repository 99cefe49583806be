"""Smoothed paths: as good as if the motion were known to be a random walk, straight or periodic."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dct
from scipy.interpolate import interp1d

from invert.tracking.smoothing import PathNoise, error_in_groups, smooth

FRAMES, NOISE = 300, 0.7


def step_errors(true: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """Return the mean square errors of the steps after and before smoothing, over the variance of the noise of a step."""
    seen = true + np.concatenate([np.zeros((1, 2)), np.cumsum(NOISE * rng.standard_normal((len(true) - 1, 2)), 0)])
    found = smooth(seen, PathNoise(np.full(2, NOISE**2)))
    return tuple(float((np.diff(one - true, axis=0) ** 2).mean()) / NOISE**2 for one in (found, seen))


@pytest.mark.parametrize("rate", [0.001, 0.03, 1.0])
def test_a_random_walk_of_the_steps_is_followed_as_well_as_a_known_one(rate):
    """Wiener's filter for a known variance q per frame leaves the mean of q / (q + l) with l = 2 - 2 cos(pi k / n). If q is small, few
    coefficients tell it, which costs a third more."""
    curve = 2.0 - 2.0 * np.cos(np.pi * np.arange(FRAMES - 1) / (FRAMES - 1))
    known = float(np.mean(rate / (rate + curve)))
    left = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        steps = np.array([3.0, -1.0]) + np.cumsum(NOISE * rate**0.5 * rng.standard_normal((FRAMES - 1, 2)), 0)
        left.append(step_errors(np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)]), rng)[0])
    assert 0.9 * known < np.mean(left) < 1.4 * known


def test_a_straight_path_becomes_straight():
    """Its mean step alone has an error of 1 / n; noise looks like a slow change or a vibration in few cases."""
    straight = np.arange(FRAMES)[:, None] * np.array([1.7, -3.6])
    left = [step_errors(straight, np.random.default_rng(seed))[0] for seed in range(40)]
    assert np.median(left) < 2.0 / FRAMES
    assert np.mean(left) < 0.02


def test_a_vibration_beside_a_slow_curve_stays():
    """Two pixels at any frequency: of its steps, less than a tenth of the power is lost."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        numbers = np.arange(FRAMES)[:, None]
        curve = 40.0 * np.sin(3.0 * numbers / FRAMES) * np.array([1.0, -0.5])
        shaken = 2.0 * np.sin(rng.uniform(0.3, 2.8) * numbers) * np.array([1.0, 0.6])
        left, before = step_errors(curve + shaken - (curve + shaken)[0], rng)
        assert left < 0.1 * np.diff(shaken, axis=0).var() / NOISE**2
        assert left < before


def test_short_paths_and_paths_of_unknown_error_stay():
    path = np.array([[0.0, 0.0], [1.0, 2.0], [3.0, 1.0]])
    np.testing.assert_allclose(smooth(path, PathNoise()), path, atol=1e-4)
    assert smooth(path[:2], PathNoise(np.ones(2))) == pytest.approx(path[:2])


def test_a_single_jump_is_not_spread_over_its_neighbours():
    """Six pixels between two frames, nine standard deviations of a step."""
    for seed in range(10):
        straight = np.arange(FRAMES)[:, None] * np.array([1.7, -3.6])
        straight[150:] += np.array([6.0, -6.0])
        assert step_errors(straight, np.random.default_rng(seed))[0] < 0.05


def drawn_noise(rng: np.random.Generator, noise: PathNoise, frames: int) -> np.ndarray:
    """Return the errors (frames, 2) of a path whose groups were registered in pairs up to a reach apart, with straight lines between."""
    count = frames // noise.length
    apart = np.abs(np.arange(count)[:, None] - np.arange(count))
    joined = ((apart > 0) & (apart <= noise.reach)).astype(float)
    values, vectors = np.linalg.eigh(np.diag(joined.sum(0)) - joined)
    errors = (vectors[:, 1:] / np.sqrt(values[1:])) @ rng.standard_normal((count - 1, 2))
    middles = np.arange(count) * noise.length + 0.5 * (noise.length - 1)
    return interp1d(middles, errors, axis=0, fill_value="extrapolate")(np.arange(frames))


@pytest.mark.parametrize(("reach", "length"), [(1, 1), (4, 1), (16, 1), (3, 4)])
def test_the_noise_of_registered_pairs_has_the_spectrum_of_their_equations(reach, length):
    """Slow changes have little noise: over many positions, one over the sum of the squared distances of the pairs."""
    frames, noise = 240, PathNoise(np.ones(2), reach, length)
    paths = [drawn_noise(np.random.default_rng(seed), noise, frames) for seed in range(200)]
    seen = np.mean([dct(np.diff(one, axis=0), axis=0, norm="ortho") ** 2 for one in paths], 0).mean(1)
    expected = noise.of_steps(frames - 1)[:, 0]
    for low, high in ((0, 3), (3, 10), (10, 30), (30, 239)):
        assert seen[low:high].mean() == pytest.approx(expected[low:high].mean(), rel=0.25 if high < 4 else 0.12)
    if length == 1:
        assert expected[0] / expected.max() < 2.0 / reach


def test_errors_in_groups_are_those_of_smoothed_paths():
    """A walk whose steps change at random, registered over eight frames on each side: rms about the means of groups, and that expected."""
    left, expected = [], []
    for seed in range(20):
        rng = np.random.default_rng([seed, 9])
        of_path = PathNoise(np.ones(2), 8)
        noise = drawn_noise(rng, of_path, FRAMES + 1)
        steps = 0.05 * np.cumsum(rng.standard_normal((FRAMES, 2)), 0)
        true = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)])
        seen = true + noise - noise[0]
        away = (smooth(seen, of_path) - true)[: FRAMES // 16 * 16].reshape(-1, 16, 2)
        left.append(away.var(1).mean())
        expected.append((error_in_groups(seen, of_path, 16) ** 2).mean())
    assert np.sqrt(np.mean(left)) == pytest.approx(np.sqrt(np.mean(expected)), rel=0.2)


def test_long_paths_have_the_noise_of_short_ones():
    noise = PathNoise(np.ones(2), 6)
    long, short = noise.of_steps(4000), noise.of_steps(1000)
    np.testing.assert_allclose(long[4:3800:4], short[1:950], rtol=0.2)
    path = np.cumsum(np.random.default_rng(3).standard_normal((4001, 2)), 0)
    assert error_in_groups(path, noise, 8) == pytest.approx(error_in_groups(path[:1001], noise, 8), rel=0.1)
