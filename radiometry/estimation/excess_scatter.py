"""Scatter of a power in excess of chance, and the threshold above which it is significant."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol


class Distribution(Protocol):
    """A distribution of scipy.stats with its parameters."""

    def isf(self, q: float, /) -> float:
        """Return the value that is exceeded with the probability q."""
        ...


@dataclass(frozen=True)
class ExcessScatter:
    """Scatter of a power relative to its mean.

    Attributes:
        relative: relative standard deviation in excess of chance.
        variance_by_chance: relative variance that chance is expected to cause.
        null: distribution of the measured over the expected variance.
    """

    relative: float
    variance_by_chance: float
    null: Distribution

    @classmethod
    def of(cls, variance: float, by_chance: float, null: Distribution) -> ExcessScatter:
        """Return the scatter of a measured relative variance."""
        return cls(math.sqrt(max(variance - by_chance, 0.0)), by_chance, null)

    def threshold(self, allowed: float, probability: float) -> float:
        """Return the value that `relative` exceeds with a probability if the true excess is `allowed`."""
        expected = self.variance_by_chance + allowed**2
        return math.sqrt(max(expected * float(self.null.isf(probability)) - self.variance_by_chance, 0.0))
