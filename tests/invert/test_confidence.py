"""Confidence: its calibration, and what the agreement of pictures says of one more."""

import numpy as np
import pytest
from scipy.special import expit

from invert.network.confidence import logit_correlation_with_new_sample
from invert.training.calibration import confidence, conformal_quantiles, fit_logistic


def test_calibration_finds_the_logistic_it_was_made_with(rng):
    features = rng.standard_normal((4000, 3))
    true = [0.3, 1.2, -0.7, 0.0]
    achieved = confidence(true, features) + 0.05 * rng.standard_normal(4000)
    np.testing.assert_allclose(fit_logistic(features, achieved.clip(0.0, 1.0)), true, atol=0.05)
    assert np.isfinite(fit_logistic(np.zeros((50, 3)), np.full(50, 0.7))).all()


@pytest.mark.parametrize(("count", "noise"), [(1, 1.0), (8, 2.0), (12, 0.3)])
def test_agreement_tells_the_correlation_with_one_more(rng, count, noise):
    """Correlation of copies of one image with independent noise."""
    pictures = rng.standard_normal(40_000) + noise * rng.standard_normal((count + 1, 40_000))
    pairs = np.corrcoef(pictures)[np.triu_indices(count + 1, 1)]
    expected = np.corrcoef(pictures[:-1].mean(0), pictures[-1])[0, 1]
    assert expit(logit_correlation_with_new_sample(float(pairs.mean()), count)) == pytest.approx(expected, abs=0.02)


def test_conformal_intervals_hold_new_errors_as_often_as_stated():
    """Nineteen skewed errors, of which no family is known: 80 % of new errors lie between the quantiles at 0.1 and 0.9."""
    rng = np.random.default_rng(3)
    held = []
    for _ in range(4000):
        quantiles = conformal_quantiles(rng.gamma(0.5, size=19).tolist())
        low, high = np.interp((0.1, 0.9), np.linspace(0.0, 1.0, len(quantiles)), quantiles)
        held.append(low <= rng.gamma(0.5) <= high)
    assert abs(np.mean(held) - 0.8) < 3.0 * (0.16 / len(held)) ** 0.5
