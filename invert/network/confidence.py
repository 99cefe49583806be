"""What the confidence of a network's reconstruction is made of: features known without a truth, weighted by a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit, logit


class ConfidenceFeatures(NamedTuple):
    """Known of a reconstruction without a truth.

    Attributes:
        expected: logit of the correlation with the truth that the network expects.
        agreement: of the augmentations or samples that were averaged; see `logit_correlation_with_new_sample`.
        retrieval_agreement: of the classical starts, from the estimate as it is.
        denoised_agreement: of the classical starts, from the denoised estimate.
    """

    expected: float
    agreement: float
    retrieval_agreement: float
    denoised_agreement: float


def logit_correlation_with_new_sample(agreement: float, count: int) -> float:
    """Logit of the correlation of the mean of `count` pictures, any two of which correlate by `agreement`, with one more.

    Were the truth one more of them, this would be the mean's correlation with it: that of samples of the posterior.
    """
    alike = min(max(agreement, 0.01), 1.0)
    return float(logit(min(alike / (alike + (1.0 - alike) / count) ** 0.5, 0.99)))


DEFAULT_COEFFICIENTS = (0.0, 1.0, 0.0, 0.0, 0.0)
"""Coefficients of a network without calibration: what it expects of itself."""


def confidence(coefficients: Sequence[float], features: Sequence[float] | np.ndarray) -> np.ndarray:
    """Expected correlation with the truth, 0 to 1, of features (..., 4): a logistic function, its offset first."""
    return expit(coefficients[0] + np.asarray(features) @ np.asarray(coefficients[1:]))


def is_calibration(found: Any) -> bool:
    """Whether a card's entry holds coefficients of each quality, and, if any, rising quantiles of the errors of sizes."""
    if not isinstance(found, dict):
        return False
    coefficients = [one for name, one in found.items() if name != "sizes"]
    sizes = found.get("sizes", {})
    return (
        isinstance(sizes, dict)
        and all(_finite(one) and len(one) == len(DEFAULT_COEFFICIENTS) for one in coefficients)
        and all(_finite(one) and len(one) > 1 and one == sorted(one) for one in sizes.values())
    )


def _finite(found: Any) -> bool:
    """Whether it is a list of finite numbers."""
    return isinstance(found, list) and all(type(value) in (int, float) and abs(value) < 1e300 for value in found)
