"""Commands: argument parsing, the exit code of bad input, and interruption."""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from types import FrameType
from typing import Any, NoReturn

from correlograph.errors import MAX_FOUND_CHARS, InputError, missing_package


class ArgumentParser(argparse.ArgumentParser):
    """argparse whose usage errors are one line, like every other error of the commands; no abbreviated options."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def add_overwrite(self) -> None:
        """Add `--overwrite`, the permission to replace a user's files of the output's names."""
        self.add_argument(
            "--overwrite",
            action="store_true",
            help="replace files with the names of output files, even if correlograph did not write them or they were edited",
        )

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {self.prog}: {message}; see '{self.prog} --help'\n")


GRACE_S = 20.0
"""Seconds that an interrupted command has for its clean-up."""


RETRY_S = 0.05
"""Seconds after which an interruption is tried again that found a library partly loaded, in which an exception can abort."""


QUIET_TRACKER = "ignore::UserWarning:multiprocessing.resource_tracker"
"""Filter of warnings: the process that tracks semaphores reports those that an interrupted command leaves behind."""


class Interrupted(KeyboardInterrupt):
    """SIGINT or SIGTERM reached a command."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = 128 + number
        self.told = False
        self.waits = False  # until a library has loaded

    def leave_in(self, seconds: float) -> None:
        """End the process after this number of seconds, even if a call of a library has not returned."""
        watch = threading.Timer(seconds, self._leave)
        watch.daemon = True
        watch.start()

    def _leave(self) -> NoReturn:
        if not self.told:
            os.write(2, b"interrupted\n")
        os._exit(self.exit_code)


def run_command(main: Callable[[Sequence[str] | None], None], argv: Sequence[str] | None = None) -> NoReturn:
    """Run a command's `main` and exit: 0; 2 with one line for bad input; 130 or 143 when interrupted."""
    arrived: list[Interrupted] = []
    _open_closed_streams()
    os.environ["MPLBACKEND"] = "agg"  # commands open no windows
    # Torch's threads otherwise wait for one another in busy loops, which slows two jobs on shared cores tenfold.
    os.environ.setdefault("GOMP_SPINCOUNT", "1000")
    warnings.filterwarnings("ignore", module="astropy|tifffile|PIL|zarr|h5py")  # damaged files are named in one line of our own
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), QUIET_TRACKER)))

    def interrupt(number: int, frame: FrameType | None) -> None:
        if not arrived:
            arrived.append(Interrupted(number))
            arrived[0].leave_in(GRACE_S)
        if not _is_loading(frame):
            raise arrived[0]
        if not arrived[0].waits:
            arrived[0].waits = True
            again = threading.Timer(RETRY_S, retry, [number])
            again.daemon = True
            again.start()

    def retry(number: int) -> None:
        arrived[0].waits = False
        if signal.getsignal(number) is not interrupt:
            return
        if hasattr(signal, "pthread_kill"):  # wakes the main thread, which may wait
            signal.pthread_kill(threading.main_thread().ident, number)
        else:
            signal.raise_signal(number)

    main_thread = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)} if main_thread else {}
    try:
        main(argv)
    except InputError as error:
        _leave(f"error: {error}", 2, arrived)
    except ModuleNotFoundError as error:
        if not isinstance(found := missing_package(error), InputError):
            raise
        _leave(f"error: {found}", 2, arrived)
    except BrokenPipeError:  # the reader of the output, such as `head`, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(128 + signal.SIGPIPE if hasattr(signal, "SIGPIPE") else 1)
    except OSError as error:
        found = f"{' '.join(str(error).split()):.{MAX_FOUND_CHARS}}"
        line = f"error: files: expected ones that can be read and written, found {found}; check paths, rights and free space"
        _leave(line, 2, arrived)
    except MemoryError:
        _leave("error: memory: expected enough for this input, found too little; give a smaller one", 2, arrived)
    except KeyboardInterrupt:
        _leave("interrupted", 130, arrived)
    except BaseException:
        if not arrived:
            raise
        _leave("interrupted", 130, arrived)  # a library that was interrupted may raise any exception
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    sys.exit(0)


def _open_closed_streams() -> None:
    """Open the null device in place of standard streams that the caller closed, so that no output file receives its file
    descriptor (0 to 2).
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
            setattr(sys, name, os.fdopen(number, mode, closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")  # for names that the terminal cannot show


def _is_loading(frame: FrameType | None) -> bool:
    """Return whether an import is in progress in this frame or in one that called it."""
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def run_module(name: str, argv: Sequence[str] | None = None) -> NoReturn:
    """Import a command's module and run its `main`; an interruption during the import also ends in one line."""
    run_command(lambda arguments: import_module(name).main(arguments), argv)


def _leave(line: str, code: int, arrived: Sequence[Interrupted]) -> NoReturn:
    if arrived:
        line, code = "interrupted", arrived[0].exit_code
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)  # no further interruption during the clean-up
    print(line, file=sys.stderr, flush=True)
    if arrived:
        arrived[0].told = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # libraries that were stopped during their work print at exit
    sys.exit(code)
