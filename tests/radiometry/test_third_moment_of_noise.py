"""Third moment of shot noise alone: sums over lags are those of the frames, unless the filter is a thin ring, which counts as an error."""

import numpy as np
import pytest
import torch

from correlograph.lags import LAGS, lag_grid
from radiometry.autocorrelation import patch_grid
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator
from radiometry.estimation.third_moment import error_of_sums, shot_noise_part

RADIUS = np.hypot(*np.indices((2 * LAGS + 1,) * 2) - LAGS)

THIN_RING = 0.5 * ((RADIUS > 3.9) & (RADIUS < 4.3))
DISC = 0.5 * ((RADIUS > 1.5) & (RADIUS < 12.0))


@pytest.mark.parametrize(("weight", "deviation"), [(DISC, 0.0), (THIN_RING, 0.375)], ids=["disc", "ring"])
def test_the_third_moment_of_noise_is_the_sum_over_lags_within_its_error(rng, weight, deviation):
    """Poisson noise of mean 0.5 in frames of 700 x 900 pixels: gain and variance are known."""
    grid = patch_grid((700, 900), 128, LAGS)
    estimator = AutocorrelationEstimator(grid, mean="pooled")
    for _ in range(8):
        estimator.add(torch.from_numpy(rng.poisson(0.5, (700, 900)).astype(np.float32)))
    measured, error = estimator.filtered_frames().third_moment(weight)
    expected = shot_noise_part(weight, np.zeros_like(weight), 0.5, int(np.prod(grid.patch_shape)))
    found = error_of_sums(weight)
    assert abs(measured / expected - 1.0) < found + 4.0 * error / expected
    assert found == pytest.approx(deviation, abs=0.1)
    if deviation:
        assert abs(measured / expected - 1.0) > 0.5 * found


def test_no_lags_leave_the_sum_unknown():
    assert error_of_sums(np.zeros((lag_grid(LAGS).side,) * 2)) == np.inf
