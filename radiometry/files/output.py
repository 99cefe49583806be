"""Output folders and files: nothing is ever half-written under a final name."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from radiometry.errors import InputError


def output_folder(path: str | Path) -> Path:
    """Create (or accept) a folder that can be written to; raise InputError otherwise."""
    if not str(path).strip():
        raise InputError("output folder", "a name", "an empty one", "choose another with -o")
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".write-probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError("output folder", "a folder that can be written to", f"{folder} ({error.strerror})",
                         "choose another with -o") from None
    return folder


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Give a temporary name beside `path`; rename it to `path` only when the block succeeds."""
    partial = path.with_name(f".partial-{os.getpid()}-{path.name}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        raise InputError("output file", "a file that can be written", f"{path} ({error.strerror})",
                         "free some space or choose another folder with -o") from None
    finally:
        partial.unlink(missing_ok=True)


def save_array(path: Path, array: np.ndarray) -> None:
    """Write an .npy file (never a pickle)."""
    with atomic(path) as partial, open(partial, "wb") as stream:
        np.save(stream, array, allow_pickle=False)


def save_json(path: Path, content: dict[str, Any]) -> None:
    """Write strict JSON (no NaN), indented, ending in a newline."""
    with atomic(path) as partial:
        partial.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")


@contextmanager
def silenced() -> Iterator[None]:
    """Keep a library's messages off the terminal where our own error repeats them."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
