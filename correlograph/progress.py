"""Progress of long work."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[..., object]
"""Called with the number of steps done since the last call; 1 if it is left out."""


def no_progress(steps: int = 1) -> None:
    """Ignore progress."""


@contextmanager
def stage(what: str) -> Iterator[None]:
    """Show on a terminal what a command is doing, until it is done."""
    shows = sys.stderr is not None and sys.stderr.isatty()
    if shows:
        print(f"{what} ...", end="", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        if shows:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
