"""Certificate of a field: does it predict counts that it has not seen?

A few per cent of the pixels are held out. A field that fits noise predicts them no better than the filtered counts around them do; one
that is right does. The comparison needs no truth and no training.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import torch
from scipy.stats import norm
from torch.nn.functional import avg_pool2d

from invert.choices import MAX_FIELD_PASSES
from invert.field.counts import FrameCounts
from invert.field.forward_model import MIN_EXPECTED, log_likelihood
from invert.field.prior import FLOORS

MAX_FALSE_ACCEPTANCE = 1e-3
"""Probability that a field that predicts held-out counts only as well as the filtered counts is accepted."""

MAX_CANDIDATES = 2 + MAX_FIELD_PASSES * len(FLOORS)
"""Maximum number of fields of a capture among which the held-out pixels choose: modes, priors and their floors."""

MIN_GAIN_SIGMA = float(norm.isf(MAX_FALSE_ACCEPTANCE / MAX_CANDIDATES))
"""Minimum gain in standard errors (Bonferroni)."""

BLOCK_PIXELS = 16
"""Side of the blocks from whose sums the error of the gain is estimated, because pixels of one grain are not independent."""


@dataclass(frozen=True)
class Prediction:
    """Prediction of the held-out pixels of one frame.

    Attributes:
        pixels: number of held-out pixels.
        gain_nats: log-likelihood by the field minus that by the filtered counts.
        variance: variance of that difference by chance.
        chi_squared: chi^2 per pixel of a constant, the filtered counts and the field.
    """

    pixels: int
    gain_nats: float
    variance: float
    chi_squared: tuple[float, float, float]

    def is_worse_than(self, other: Prediction) -> bool:
        """Return whether the gain is lower than another one by more than its standard error."""
        return self.gain_nats < other.gain_nats - self.variance**0.5


@dataclass(frozen=True)
class Certificate:
    """Predictions of all frames together.

    Attributes:
        pixels: number of held-out pixels.
        gain_nats_per_pixel, gain_error: log-likelihood of the held-out counts by the field minus that by the filtered counts, per
            pixel, and its standard error.
        chi_squared_constant, chi_squared_filtered, chi_squared_field: squared deviation over expected counts, per held-out pixel.
    """

    pixels: int
    gain_nats_per_pixel: float
    gain_error: float
    chi_squared_constant: float
    chi_squared_filtered: float
    chi_squared_field: float

    @classmethod
    def of(cls, predictions: Sequence[Prediction]) -> Certificate:
        """Combine the predictions of independent frames."""
        pixels = sum(one.pixels for one in predictions)
        gain = sum(one.gain_nats for one in predictions) / pixels
        error = sum(one.variance for one in predictions) ** 0.5 / pixels
        chi = [sum(one.pixels * one.chi_squared[kind] for one in predictions) / pixels for kind in range(3)]
        return cls(pixels, gain, error, *chi)

    @property
    def gain_sigma(self) -> float:
        """Gain in standard errors."""
        return self.gain_nats_per_pixel / self.gain_error if self.gain_error > 0.0 else 0.0

    @property
    def is_accepted(self) -> bool:
        """Whether the field predicts held-out counts significantly better than the filtered counts do."""
        return self.gain_sigma > MIN_GAIN_SIGMA

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Certificate:
        """Return the certificate that `as_dict` described."""
        return cls(int(values["pixels"]), *(float(values[one.name]) for one in fields(cls) if one.name != "pixels"))

    def as_dict(self) -> dict[str, Any]:
        """Return the certificate for JSON."""
        return asdict(self) | {"gain_sigma": self.gain_sigma, "accepted": self.is_accepted}


def predict_held_out(counts: FrameCounts, by_field: torch.Tensor, by_filter: torch.Tensor) -> Prediction:
    """Compare two predictions (expected counts on the frame) with the held-out counts of a frame."""
    seen = counts.values[counts.held_out].double()
    constant = float(counts.values[counts.fitted].double().mean())
    predictions = [one[counts.held_out].double().clamp_min(MIN_EXPECTED) for one in (by_filter, by_field)]
    filtered, field = (log_likelihood(seen, one, counts.roughness) for one in predictions)
    gain = field - filtered
    deviations = torch.zeros(counts.values.shape, dtype=torch.float64, device=seen.device)
    deviations[counts.held_out] = gain - gain.mean()
    blocks = avg_pool2d(deviations[None], BLOCK_PIXELS, ceil_mode=True, divisor_override=1)
    expected = (torch.full_like(seen, max(constant, MIN_EXPECTED)), *predictions)
    chi = tuple(float(((seen - one).square() / one).mean()) for one in expected)
    return Prediction(len(seen), float(gain.sum()), float(blocks.square().sum()), (chi[0], chi[1], chi[2]))
