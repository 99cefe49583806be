"""What the confidence of a network's reconstruction is made of: features known without a truth, weighted by a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import expit


class ConfidenceFeatures(NamedTuple):
    """Known of a reconstruction without a truth.

    Attributes:
        expected: logit of the correlation with the truth that the network expects.
        agreement: of the candidates that were averaged, with one another.
        retrieval_agreement: of the classical starts, from the estimate as it is.
        denoised_agreement: of the classical starts, from the denoised estimate.
    """

    expected: float
    agreement: float
    retrieval_agreement: float
    denoised_agreement: float


UNCALIBRATED = (0.0, 1.0, 0.0, 0.0, 0.0)
"""Coefficients of a network without calibration: what it expects of itself."""


def confidence(coefficients: Sequence[float], features: Sequence[float] | np.ndarray) -> np.ndarray:
    """Expected correlation with the truth, 0 to 1, of features (..., 4): a logistic function, its offset first."""
    return expit(coefficients[0] + np.asarray(features) @ np.asarray(coefficients[1:]))
