"""Vibrations in a path: found with frequency and amplitude, and hardly ever where there is none."""

import numpy as np
import pytest

from invert.tracking.vibration import FALSE_ALARM, find_vibrations

PATHS = 300


def paths(kind, frames, rng):
    """Yield paths without vibration."""
    times = np.linspace(0.0, 1.0, frames)
    for _ in range(PATHS):
        noise = rng.standard_normal((frames, 2)) * (1.0, 0.3)
        if kind == "walk":  # errors that add up along the path
            yield np.cumsum(noise, 0)
        elif kind == "curve":
            turns = rng.uniform(0.0, 2.0 * np.pi, 2)
            yield 200.0 * np.stack([np.sin(turns[0] * times), np.cos(turns[1] * times)], 1) + 0.3 * noise
        else:
            yield noise


@pytest.mark.parametrize("frames", [24, 31, 40, 130])
@pytest.mark.parametrize("kind", ["white", "walk", "curve"])
def test_false_alarms_are_as_rare_as_stated(kind, frames, rng):
    """Their number exceeds this limit with a probability of a thousandth at the stated rate of 1 %."""
    assert sum(bool(find_vibrations(one)) for one in paths(kind, frames, rng)) <= 10
    assert FALSE_ALARM == 0.01


def test_two_vibrations_of_a_curved_path(rng):
    numbers = np.arange(120.0)
    path = np.stack([0.02 * numbers**2, -3.0 * numbers], 1) + 0.2 * rng.standard_normal((120, 2))
    path += np.outer(np.sin(2.0 * np.pi * 0.3 * numbers), [1.0, 0.2]) + np.outer(
        np.cos(2.0 * np.pi * 0.15 * numbers), [0.0, 0.6]
    )
    first, second = find_vibrations(path)
    assert (first.periods_per_frame, second.periods_per_frame) == pytest.approx((0.3, 0.15), abs=0.005)
    assert first.amplitude_pixels == pytest.approx((1.0, 0.2), abs=0.12)
    assert second.amplitude_pixels == pytest.approx((0.0, 0.6), abs=0.12)


@pytest.mark.parametrize(
    ("frames", "periods"), [(120, (0.25, 0.3)), (60, (0.2, 0.28)), (40, (0.42,)), (120, (0.47,)), (24, (0.3,))]
)
def test_neighbours_and_high_frequencies_are_found(frames, periods, rng):
    numbers = np.arange(frames)
    path = 0.05 * rng.standard_normal((frames, 2)) + sum(
        np.outer(np.sin(2.0 * np.pi * one * numbers), [1, 0.5]) for one in periods
    )
    found = sorted(one.periods_per_frame for one in find_vibrations(path))
    assert found == pytest.approx(periods, abs=0.6 / frames)


@pytest.mark.parametrize("place", [20.0, 20.25, 20.5, 20.8])
def test_frequency_and_amplitude_between_those_of_the_spectrum(place, rng):
    """Half a frequency off, the highest value of the window's spectrum is 0.85 of its maximum. Rows and columns move against each other."""
    numbers = np.arange(80.0)
    path = np.outer(np.sin(2.0 * np.pi * place / 80.0 * numbers + 0.4), [1.0, -0.5]) + 0.1 * rng.standard_normal((80, 2))
    (one,) = find_vibrations(path)
    assert one.periods_per_frame == pytest.approx(place / 80.0, abs=0.1 / 80.0)
    assert one.amplitude_pixels == pytest.approx((1.0, 0.5), abs=0.06)
    assert (one.phasor_pixels[1] / one.phasor_pixels[0]).real == pytest.approx(-0.5, abs=0.06)


@pytest.mark.parametrize("frames", [1, 3, 13, 14, 20])
def test_a_short_path_has_none_or_some(frames, rng):
    """So few frames have hardly any other frequencies to compare with."""
    assert len(find_vibrations(rng.standard_normal((frames, 2)))) <= 1
