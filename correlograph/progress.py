"""Progress of long work."""

from collections.abc import Callable

Progress = Callable[..., object]
"""Called with the number of steps done since the last call; 1 if it is left out."""


def no_progress(steps: int = 1) -> None:
    """Ignore progress."""
