"""One guard around the decoders of file formats: whatever they raise becomes one line, and they print nothing."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from correlograph.errors import InputError

CHATTY = ("tifffile", "PIL")
"""Loggers of packages that report damage to the terminal as well; their messages still reach handlers of a program's own."""

for _name in CHATTY:
    logging.getLogger(_name).addHandler(logging.NullHandler())


@contextmanager
def decoding(file: Path) -> Iterator[None]:
    """Turn every exception of a decoder into an InputError that names the file."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # every decoder raises its own exceptions
        found = f"{file} ({type(error).__name__})"
        raise InputError("frame", "a file that can be read", found, "write it again or leave it out") from None
