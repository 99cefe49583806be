"""The one error users meet, and the one place that turns it into exit code 2."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn


class InputError(ValueError):
    """Input that cannot be used: its name, what was expected, what was found, and the remedy.

    The message is always one line, because a shell prints it as it is.
    """

    def __init__(self, name: str, expected: str, found: object, remedy: str) -> None:
        text = f"{name}: expected {expected}, found {found}; {remedy}"
        super().__init__(" ".join(text.split()))
        self._parts = (name, expected, str(found), remedy)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """Pickled between worker processes."""
        return type(self), self._parts


class ArgumentParser(argparse.ArgumentParser):
    """argparse whose usage errors are one line, like every other error of the commands; no abbreviated options."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {self.prog}: {message}; see '{self.prog} --help'\n")


LARGEST = 1e15
SMALLEST = 1e-30


def positive(name: str, value: float, *, zero_allowed: bool = False) -> float:
    """Return `value` as a float if it lies within bounds that no physical quantity in SI units leaves.

    Raises InputError for anything else, NaN and text included.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if SMALLEST <= number <= LARGEST or (zero_allowed and number == 0.0):
        return number
    kind = f"a number{' that is zero or' if zero_allowed else ''} between {SMALLEST:g} and {LARGEST:g}"
    raise InputError(name, kind, value, f"correct {name}")


def check_seed(seed: int) -> int:
    """Seeds fit the frame header's 32-bit integer."""
    if not 0 <= seed < 2**31:
        raise InputError("--seed", "a whole number from 0 to 2147483647", seed, "choose another")
    return seed


def check_device(device: str) -> None:
    """Refuse `cuda` where torch has no GPU to use."""
    if device == "cuda":
        import torch  # heavy, and wanted only here

        if not torch.cuda.is_available():
            raise InputError("--device", "a CUDA GPU and a torch build that uses it", "none", "use --device cpu")


def run_command(main: Callable[[Sequence[str] | None], None], argv: Sequence[str] | None = None) -> NoReturn:
    """Run a command's `main` and exit: 0, or 2 with one line for bad input, or 130 when interrupted."""
    try:
        main(argv)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        found = " ".join(str(error).split())
        print(f"error: files: expected ones that can be read and written, found {found}; check paths, rights and free space",
              file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    sys.exit(0)
