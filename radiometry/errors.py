"""The one error users meet, and the one place that turns it into exit code 2."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn


class InputError(ValueError):
    """Input that cannot be used: its name, what was expected, what was found, and the remedy.

    The message is always one line, because a shell prints it as it is.
    """

    def __init__(self, name: str, expected: str, found: object, remedy: str) -> None:
        text = f"{name}: expected {expected}, found {found}; {remedy}"
        super().__init__(" ".join(text.split()))


class ArgumentParser(argparse.ArgumentParser):
    """argparse whose usage errors are one line, like every other error of the commands."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; see '{self.prog} --help'\n")


def positive(name: str, value: float, *, zero_allowed: bool = False) -> float:
    """Return `value` as a float if it is finite and positive; raise InputError otherwise."""
    number = float(value)
    if not (0.0 <= number < float("inf")) or (number == 0.0 and not zero_allowed):
        kind = "a finite number, zero or more" if zero_allowed else "a finite number above zero"
        raise InputError(name, kind, value, f"correct {name}")
    return number


def run_command(main: Callable[[Sequence[str] | None], None], argv: Sequence[str] | None = None) -> NoReturn:
    """Run a command's `main` and exit: 0, or 2 with one line for bad input, or 130 when interrupted."""
    try:
        main(argv)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    sys.exit(0)
