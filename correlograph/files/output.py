"""Output folders and files; a final name never refers to a partially written file."""

from __future__ import annotations

import io
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.errors import InputError
from correlograph.files.manifest import (
    MANIFEST,
    PARTIAL,
    claim,
    digest_of,
    digests_in,
    record,
    record_temporary,
    remove_temporary,
    remove_unused_manifest,
)

LOCK = ".correlograph-lock"
"""Name of the lock in an output folder; prefix of the name of a lock next to a file."""


def path_of(name: str, value: object) -> Path:
    """Return a path. Raises InputError for anything else than text and paths."""
    if not isinstance(value, (str, Path)) or "\0" in str(value):
        raise InputError(name, "a path", f"{value!r:.60}", "provide the name of a file or folder")
    return Path(value)


def output_folder(path: str | Path) -> Path:
    """Create or accept a writable folder. Raises InputError otherwise."""
    path_of("output folder", path)
    if not str(path).strip():
        raise InputError("output folder", "a name", "an empty one", "choose another with -o")
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(
            "output folder", "a folder that can be written to", f"{folder} ({error.strerror})", "choose another with -o"
        ) from None
    return folder


@contextmanager
def sole_writer(output: str | Path, name: str = "output folder") -> Iterator[None]:
    """Exclude other processes from writing the same folder or file, and remove what killed runs left there.

    At the end, the manifest is removed if it lists no other file in the folder.

    The lock lies in the folder, or next to the file or store, so it works for every user and machine that shares the file
    system, whatever the temporary folder. It is removed if its process on this machine has died. Outputs with a URL have no
    lock.

    Raises InputError if another process is writing.
    """
    from filelock import SoftFileLock, Timeout

    if "://" in str(output):
        yield
        return
    path = Path(output).resolve()
    is_folder = name == "output folder"
    if not path.name:
        raise InputError(name, "a name", f"the root {path}", "choose another one")
    lock_path = path / LOCK if is_folder else path.with_name(f"{LOCK}-{path.name}")
    lock = SoftFileLock(lock_path, timeout=0)
    try:
        lock_path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        found = f"{output}, which one is"
        remedy = f"wait until it has ended, or remove {lock_path} if it ended on another machine"
        raise InputError(name, "one that no other process is writing", found, remedy) from None
    except OSError as error:
        found = f"{output} ({error.strerror})"
        raise InputError(name, "one that can be written to", found, "choose another name") from None
    try:
        if is_folder:
            remove_temporary(path)
        else:
            remove_temporary(path.parent, path.stem)
        try:
            yield
        finally:
            if is_folder:
                remove_unused_manifest(path, LOCK)
    finally:
        lock.release()


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield a temporary name in the folder of `path`; rename it to `path` only if the block succeeds.

    Raises InputError if the name belongs to a user's file.
    """
    partial = path.with_name(f"{PARTIAL}{os.getpid()}-{path.name}")
    try:
        claim(path.parent, [path.name])
        record_temporary(partial)
        yield partial
        record(path.parent, {path.name: digest_of(partial)})
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


@contextmanager
def staging_folder(folder: Path) -> Iterator[Path]:
    """Create a hidden folder inside `folder` for files that will replace others as a whole; it is removed afterwards."""
    staging = folder / f"{PARTIAL}{os.getpid()}"
    record_temporary(staging)
    staging.mkdir()
    try:
        yield staging
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def replace_files(staging: Path, folder: Path, older: Iterable[str], last: str) -> None:
    """Move all files of a staging folder into a folder, the one named `last` at the end, and remove older files that are not among them.
    The file `last`, which describes the others, is absent meanwhile.
    """
    new = [path.name for path in staging.iterdir() if path.name != MANIFEST]
    claim(folder, dict.fromkeys([*new, *older]))  # files may have appeared during the work
    record(folder, digests_in(staging))
    (folder / last).unlink(missing_ok=True)
    for name in older:
        if name not in new:
            (folder / name).unlink(missing_ok=True)
    for name in sorted(new, key=lambda one: one == last):
        os.replace(staging / name, folder / name)


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
