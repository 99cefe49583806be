"""Error of an estimate that a correlation requires."""

import numpy as np
import pytest

from correlograph.errors import InputError
from invert.choices import FAST
from invert.evaluation.required_error import floor_for, floorless_error, required_error
from radiometry.autocorrelation import autocorrelate
from radiometry.noise.budget import estimate_error


def letter_l() -> np.ndarray:
    albedo = np.zeros((64, 64), np.float32)
    albedo[20:42, 24:28] = albedo[38:42, 24:38] = 1.0
    return albedo


def signal_of(albedo: np.ndarray) -> np.ndarray:
    correlation = autocorrelate(albedo)
    return correlation / correlation.max()


def test_the_floor_has_the_error_that_it_is_for():
    signal = signal_of(letter_l())
    floor = floor_for(0.8, signal, 300.0)
    assert estimate_error(float(signal.sum()), float((signal**2).sum()), signal.size, floor, 300.0) == pytest.approx(0.8)
    assert floor_for(0.5 * floorless_error(signal, 300.0), signal, 300.0) == 0.0


def test_a_higher_correlation_requires_a_smaller_error():
    albedo = letter_l()
    low, high = (
        required_error(albedo, signal_of(albedo), np.ones((127, 127), np.float32), 300.0, goal, FAST) for goal in (0.8, 0.93)
    )
    assert high < 0.9 * low


def test_a_correlation_out_of_reach_is_refused():
    albedo = letter_l()
    with pytest.raises(InputError, match="smaller error"):
        required_error(albedo, signal_of(albedo), np.ones((127, 127), np.float32), 300.0, 0.99999, FAST)
