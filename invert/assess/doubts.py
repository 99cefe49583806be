"""Doubts about a reconstruction: each with its measured value, its threshold and the probability of a false alarm."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

FALSE_ALARMS = 0.01
"""Probability that a capture without fault raises any doubt whose threshold follows from a distribution."""


class DoubtKind(Enum):
    """Possible fault."""

    HIGHLIGHT = "highlight"
    TEXTURE = "texture"
    DIFFERENT_FRAMES = "different frames"
    DIFFERENT_PARTS = "different parts"
    UNEXPLAINED_SIGNAL = "unexplained signal"
    UNLIKELY_SAMPLES = "unlikely samples"
    MOTION_BLUR = "motion blur"


FALSE_ALARMS_EACH = FALSE_ALARMS / len(DoubtKind)
"""The same probability for one kind of doubt (Bonferroni)."""


@dataclass(frozen=True)
class Doubt:
    """A reason to doubt a reconstruction, whether or not it is raised.

    Attributes:
        value: measured value.
        threshold: value beyond which the doubt is raised.
        false_alarms: probability that a capture without this fault, or with as much of it as is allowed, raises the doubt; None if
            it is only known from clean captures (docs/cameras.md).
        advice: finding and remedy, one sentence.
        is_low: whether values below the threshold raise the doubt.
    """

    kind: DoubtKind
    value: float
    threshold: float
    false_alarms: float | None
    advice: str
    is_low: bool = False

    @property
    def is_raised(self) -> bool:
        """Whether the value lies beyond the threshold."""
        return self.value < self.threshold if self.is_low else self.value > self.threshold

    def as_dict(self) -> dict[str, Any]:
        """Return the doubt for JSON."""
        return {
            "kind": self.kind.value,
            "value": self.value,
            "threshold": self.threshold,
            "raised_if": "below" if self.is_low else "above",
            "raised": self.is_raised,
            "false_alarms": self.false_alarms,
            "advice": self.advice,
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Doubt:
        """Return the doubt that `as_dict` described."""
        rate = values["false_alarms"]
        return cls(
            DoubtKind(values["kind"]),
            float(values["value"]),
            float(values["threshold"]),
            None if rate is None else float(rate),
            str(values["advice"]),
            values["raised_if"] == "below",
        )
