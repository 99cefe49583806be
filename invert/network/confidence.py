"""Confidence of a network's reconstruction: features known without a truth, combined by a calibrated logistic function."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit, logit


class ConfidenceFeatures(NamedTuple):
    """Features of a reconstruction that are known without a truth.

    Attributes:
        expected: logit of the correlation with the truth that the network predicts.
        agreement: pairwise correlation of the augmentations or samples; see `logit_correlation_with_new_sample`.
        retrieval_agreement: mean correlation of the classical starts from the estimate.
        denoised_agreement: mean correlation of the classical starts from the denoised estimate.
    """

    expected: float
    agreement: float
    retrieval_agreement: float
    denoised_agreement: float


def logit_correlation_with_new_sample(agreement: float, count: int) -> float:
    """Return the logit of the correlation of the mean of `count` images, which correlate by `agreement` in pairs, with a new one.

    If the truth were a further sample, this would be its correlation with the mean.
    """
    alike = min(max(agreement, 0.01), 1.0)
    return float(logit(min(alike / (alike + (1.0 - alike) / count) ** 0.5, 0.99)))


DEFAULT_COEFFICIENTS = (0.0, 1.0, 0.0, 0.0, 0.0)
"""Coefficients of a network without calibration: its own prediction."""


def confidence(coefficients: Sequence[float], features: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the predicted correlation with the truth, 0 to 1, of features (..., 4): a logistic function, whose first
    coefficient is the offset.
    """
    return expit(coefficients[0] + np.asarray(features) @ np.asarray(coefficients[1:]))


def is_calibration(found: Any) -> bool:
    """Return whether an entry of the metadata holds coefficients of each quality and increasing quantiles of the size
    errors, if any."""
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
    """Return whether an object is a list of finite numbers."""
    return isinstance(found, list) and all(type(value) in (int, float) and abs(value) < 1e300 for value in found)
