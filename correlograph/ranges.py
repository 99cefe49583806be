"""Ranges of numbers: the `type` of a command-line option and the check of the same argument in Python."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

from correlograph.errors import SI_MAX, SI_MIN, InputError
from correlograph.lags import lag_grid


@dataclass(frozen=True)
class Range:
    """Numbers from `least` to `most`; only whole multiples of `step` if both limits are int."""

    least: float
    most: float
    step: int = 1

    def __call__(self, text: str) -> Any:
        """Parse a number from the command line, an int for whole numbers; argparse adds the name of the option."""
        try:
            value = int(text) if isinstance(self.least, int) else float(text)
        except ValueError:
            value = None
        if not self.holds(value):
            raise argparse.ArgumentTypeError(f"expected {self}, found {' '.join(text.split()):.40}")
        return value

    def check(self, name: str, value: float) -> Any:
        """Return the value as an int or a float if it lies in the range. Raises InputError otherwise, also for NaN and text."""
        if not self.holds(value):
            raise InputError(name, str(self), f"{value!s:.40}", "use a value in this range")
        return int(value) if isinstance(self.least, int) else float(value)

    def holds(self, value: Any) -> bool:
        """Return whether a value lies in the range."""
        if isinstance(value, bool):
            return False
        if isinstance(self.least, int):
            return isinstance(value, Integral) and self.least <= int(value) <= self.most and int(value) % self.step == 0
        try:
            return isinstance(value, Real) and self.least <= float(value) <= self.most
        except OverflowError:
            return False

    def __str__(self) -> str:
        if isinstance(self.least, float):
            return f"a number from {self.least:g} to {self.most:g}"
        kind = "whole number" if self.step == 1 else f"multiple of {self.step}"
        return f"a {kind} from {self.least} to {self.most}"


SEED = Range(0, 2**31 - 1)
"""Seeds fit the frame header's 32-bit integer."""

CONFIDENCE = Range(0.0, 1.0)
"""Confidences and probabilities."""

FRAMES = Range(1, 10**6)
SAMPLES = Range(1, 2**28)
"""Paths of a Monte Carlo light budget; more take hours."""

WORKERS = Range(1, 256)
OBJECT_NUMBER = Range(1, 16)
SI = Range(SI_MIN, SI_MAX)
"""Bounds of any physical quantity in SI units."""
RATE = Range(1.0 / SI_MAX, SI_MAX)
"""Bounds of a rate per second, whose inverse lies within those of a time."""
WAVELENGTH = Range(1e-11, 1e-2)
"""Wavelengths in metres, from X-rays to microwaves; a value in nanometres lies outside."""
LAG_COUNT = Range(32, 255)
"""Largest lag on either side of zero."""

CELLS_PER_LAG = Range(1, 64)
"""Pixels of a fine albedo per lag."""

PATCH = Range(lag_grid(32).side, 2**31 - 1)
"""Patch sizes in pixels; a patch has at least as many pixels as lags."""

BLUR = Range(0.0, 1e4)
"""Standard deviation of a blur in pixels."""
