"""Ranges of numbers: the `type` of an option on the command line, and the check of the same argument in Python."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from radiometry.errors import LARGEST, SMALLEST, InputError


@dataclass(frozen=True)
class Range:
    """Numbers from `least` to `most`: whole ones, multiples of `step`, where these are int."""

    least: float
    most: float
    step: int = 1

    def __call__(self, text: str) -> float:
        """A number from the command line, an int where whole ones are wanted; argparse names the option."""
        try:
            return self.check("", int(text) if isinstance(self.least, int) else float(text))
        except ValueError:
            raise argparse.ArgumentTypeError(f"expected {self}, found {text:.40}") from None

    def check(self, name: str, value: float) -> float:
        """The value, if it lies in the range; InputError otherwise, NaN and text included."""
        try:
            inside = self.least <= value <= self.most and (not isinstance(self.least, int) or value % self.step == 0)
        except TypeError:
            inside = False
        if not inside:
            raise InputError(name, str(self), f"{value!s:.40}", "choose another")
        return value

    def __str__(self) -> str:
        if isinstance(self.least, float):
            return f"a number from {self.least:g} to {self.most:g}"
        kind = "whole number" if self.step == 1 else f"multiple of {self.step}"
        return f"a {kind} from {self.least} to {self.most}"


SEED = Range(0, 2**31 - 1)
"""Seeds fit the frame header's 32-bit integer."""

FRAMES = Range(1, 10**6)
WORKERS = Range(1, 256)
SI = Range(SMALLEST, LARGEST)
"""Bounds that no physical quantity in SI units leaves."""
