"""Frames of one object agree at every lag to within noise; frames of two objects do not."""

import numpy as np
import pytest

from correlograph.lags import lag_grid
from radiometry.autocorrelation import patch_grid
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator
from radiometry.estimation.excess_scatter import ExcessScatter
from radiometry.estimation.frame_differences import frame_differences
from tests.light import letter_cells, thrown

PATCH, SHAPE = 129, (400, 480)
GRID = lag_grid(63)
INNER = (GRID.ring > 1) & (GRID.ring < 30) & GRID.half_plane


def differences(frames) -> ExcessScatter | None:
    estimator = AutocorrelationEstimator(patch_grid(SHAPE, PATCH))
    for frame in frames:
        estimator.add(np.asarray(frame, np.float32))
    return frame_differences(estimator.filtered_frames(), INNER, 1.05)


def light(letter: str, rng) -> np.ndarray:
    return thrown(letter_cells(letter), SHAPE, PATCH, rng)[: SHAPE[0], : SHAPE[1]]


@pytest.mark.slow
@pytest.mark.parametrize("levels", [(0.5, 0.5), (0.3, 1.5), (2.0, 3.0, 0.4)])
def test_frames_of_one_object_agree(levels):
    """Whatever their brightness and shot noise; among five captures, the threshold of 0.01 is exceeded at most once."""
    found = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        found.append(differences([rng.poisson(level * light("F", rng)) for level in levels]))
    assert sum(one.relative > one.threshold(0.0, 0.01) for one in found) <= 1
    assert max(one.relative for one in found) < 0.15


def test_frames_of_two_objects_differ(rng):
    found = differences([rng.poisson(light(letter, rng)) for letter in "FL"])
    assert found.relative > 0.2
    assert found.relative > found.threshold(0.1, 1e-6)


def test_one_frame_has_no_differences(rng):
    assert differences([rng.poisson(light("F", rng))]) is None
