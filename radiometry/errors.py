"""The one error users meet, and the one place that turns it into exit code 2."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

LONGEST = 300
"""Characters of what was found that a message repeats."""


class InputError(ValueError):
    """Input that cannot be used: its name, what was expected, what was found, and the remedy.

    The message is always one line, because a shell prints it as it is.
    """

    def __init__(self, name: str, expected: str, found: object, remedy: str) -> None:
        found = f"{found!s:.{LONGEST}}" + ("..." if len(str(found)) > LONGEST else "")
        text = f"{name}: expected {expected}, found {found}; {remedy}".encode("utf-8", "replace").decode()
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


def memory_bytes() -> float:
    """Memory of this machine, free or not."""
    return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


def check_device(device: str) -> None:
    """Refuse `cuda` where torch has no GPU to use."""
    if device == "cuda":
        import torch  # heavy, and wanted only here

        if not torch.cuda.is_available():
            raise InputError("--device", "a CUDA GPU and a torch build that uses it", "none", "use --device cpu")


GRACE_S = 20.0
"""Time that an interrupted command has to clean up."""


QUIET_TRACKER = "ignore::UserWarning:multiprocessing.resource_tracker"
"""Filter of warnings, since the process that tracks semaphores complains of those that an interrupted command leaves behind."""


class Interrupted(KeyboardInterrupt):
    """SIGINT or SIGTERM reached a command."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = 128 + number
        self.told = False

    def leave_in(self, seconds: float) -> None:
        """End the process after so long, whatever a library then waits for."""
        watch = threading.Timer(seconds, self._leave)
        watch.daemon = True
        watch.start()

    def _leave(self) -> NoReturn:
        if not self.told:
            os.write(2, b"interrupted\n")
        os._exit(self.exit_code)


def exit_at_once_when_interrupted() -> None:
    """For the time while a command's modules are loading, when nothing was written yet: one line, and out."""
    def leave(number: int, _: Any) -> NoReturn:
        os.write(2, b"interrupted\n")
        os._exit(128 + number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, leave)


def run_command(main: Callable[[Sequence[str] | None], None], argv: Sequence[str] | None = None) -> NoReturn:
    """Run a command's `main` and exit: 0; 2 with one line for bad input; 130 or 143 when interrupted."""
    arrived: list[Interrupted] = []
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), QUIET_TRACKER)))

    def interrupt(number: int, _: Any) -> NoReturn:
        arrived.append(Interrupted(number))
        arrived[0].leave_in(GRACE_S)
        raise arrived[0]

    main_thread = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)} if main_thread else {}
    try:
        main(argv)
    except InputError as error:
        _leave(f"error: {error}", 2, arrived)
    except OSError as error:
        found = " ".join(str(error).split())
        line = f"error: files: expected ones that can be read and written, found {found}; check paths, rights and free space"
        _leave(line, 2, arrived)
    except MemoryError:
        _leave("error: memory: expected enough for this input, found too little; give a smaller one", 2, arrived)
    except KeyboardInterrupt:
        _leave("interrupted", 130, arrived)
    except BaseException:
        if not arrived:
            raise
        _leave("interrupted", 130, arrived)  # a library half loaded raises what it likes
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    sys.exit(0)


def _leave(line: str, code: int, arrived: Sequence[Interrupted]) -> NoReturn:
    if arrived:
        line, code = "interrupted", arrived[0].exit_code
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)  # clean up undisturbed
    print(line, file=sys.stderr, flush=True)
    if arrived:
        arrived[0].told = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # libraries that were stopped half-way complain at exit
    sys.exit(code)
