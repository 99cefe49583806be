"""Output folders and files; a final name never refers to a partially written file."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.errors import InputError

PARTIAL = ".correlograph-partial-"
"""Prefix of the names of incomplete files."""


def output_folder(path: str | Path) -> Path:
    """Create or accept a writable folder. Raises InputError otherwise."""
    if not str(path).strip():
        raise InputError("output folder", "a name", "an empty one", "choose another with -o")
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f"{PARTIAL}{os.getpid()}-probe"
        probe.touch()
        probe.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            "output folder", "a folder that can be written to", f"{folder} ({error.strerror})", "choose another with -o"
        ) from None
    return folder


@contextmanager
def sole_writer(output: str | Path, name: str = "output folder") -> Iterator[None]:
    """Exclude other processes of this machine from writing the same folder or file, and remove partial files of killed ones.

    Raises InputError if another process is writing. Addresses of other machines are not protected.
    """
    from filelock import FileLock, Timeout

    if "://" in str(output):
        yield
        return
    path = Path(output).resolve()
    key = hashlib.sha256(f"{getattr(os, 'getuid', int)()} {path}".encode("utf-8", "surrogateescape")).hexdigest()[:32]
    lock = FileLock(Path(tempfile.gettempdir()) / f"correlograph-{key}.lock", timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise InputError(
            name,
            "one that no other process is writing",
            f"{output}, which one is",
            "wait until it has ended, or choose another name",
        ) from None
    try:
        _remove_leftovers(path)
        yield
    finally:
        lock.release()


def _remove_leftovers(path: Path) -> None:
    """Remove partial files of killed runs in a folder, or next to a file."""
    of = "" if path.is_dir() else f"{path.stem}."
    for left in (path if path.is_dir() else path.parent).glob(f"{PARTIAL}*"):
        if left.is_dir() and not of:
            shutil.rmtree(left)
        elif left.is_file() and left.name.removeprefix(PARTIAL).partition("-")[2].startswith(of):
            left.unlink()


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield a temporary name in the folder of `path`; rename it to `path` only if the block succeeds."""
    partial = path.with_name(f"{PARTIAL}{os.getpid()}-{path.name}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        raise InputError(
            "output file",
            "a file that can be written",
            f"{path} ({error.strerror})",
            "free some space or choose another folder with -o",
        ) from None
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
def silence_output() -> Iterator[None]:
    """Suppress the messages of a library whose errors are reported by InputError."""
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
