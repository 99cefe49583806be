"""Ownership of output files: a program replaces and deletes only files that it wrote itself.

The manifest of a folder lists the SHA-256 digest and the name of every file that this program wrote there, one line each, in
the format of `sha256sum`. A file belongs to the program if a line of the manifest has its name and its present digest, so a
file that a user edited belongs to the user. Lines are only appended, and before the file changes, so that a killed run leaves
a manifest that is right.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from correlograph.errors import InputError

MANIFEST = ".correlograph-manifest"
_HEADER = b"# files that correlograph wrote here\n"
PARTIAL = ".correlograph-partial-"
"""Prefix of the names of incomplete files and folders."""

_PARTIAL_NAME = re.compile(re.escape(PARTIAL) + r"(?P<process>\d+)(-(?P<of>.*))?", re.DOTALL)
"""Names of incomplete files and folders: the process that writes them, and the name of the output."""

MAX_MANIFEST_BYTES = 2**26
_DIGEST = re.compile("[0-9a-f]{64}")
_TEMPORARY = "temporary"
"""Takes the place of a digest for files and folders that exist only during a run."""

_permitted: set[tuple[Path, str]] = set()
"""Files of a user, with their digests, that `--overwrite` permits this process to replace."""


def claim(folder: Path, names: Iterable[str], *, overwrite: bool = False) -> None:
    """Refuse output names that belong to a user's files in the folder, before work begins; with `overwrite`, permit this
    process to replace these files.

    Raises InputError for names of a user's files, and for names of folders.
    """
    taken = [folder / name for name in names if not may_write(folder / name)]
    irregular = [path for path in taken if path.is_symlink() or not path.is_file()]
    listed = ", ".join(path.name for path in taken[:3]) + (f" and {len(taken) - 3} more" if len(taken) > 3 else "")
    if irregular:
        found = f"{irregular[0].name} in {folder}, which is a folder, a link or a device"
        raise InputError("output", "names that are free", found, "move it, or choose another folder")
    if taken and not overwrite:
        found = f"{listed} in {folder}, not written by correlograph or changed since"
        raise InputError(
            "output", "names that are free", found, "choose another folder, or add --overwrite to replace these files"
        )
    if taken:
        print(f"replacing {', '.join(path.name for path in taken)} in {folder}", file=sys.stderr)
        _permitted.update((path.resolve(), digest_of(path)) for path in taken)


def may_write(path: Path) -> bool:
    """Return whether a name is free, belongs to a file of this program, or to one that it may replace."""
    if not os.path.lexists(path) or is_own(path):
        return True
    return path.is_file() and not path.is_symlink() and (path.resolve(), digest_of(path)) in _permitted


def is_own(path: Path) -> bool:
    """Return whether this program wrote a file that is unchanged since."""
    known = _read(path.parent).get(path.name, ())
    return bool(known) and not path.is_symlink() and path.is_file() and digest_of(path) in known


def are_intact(folder: Path, names: Iterable[str]) -> bool:
    """Return whether all files of these names exist as this program last wrote them."""
    known = _read(folder)
    return all(name in known and (folder / name).is_file() and digest_of(folder / name) == known[name][-1] for name in names)


def digests_in(folder: Path) -> dict[str, str]:
    """Return the names in the manifest of a folder with their latest digests, without temporary ones."""
    return {name: known[-1] for name, known in _read(folder).items() if _TEMPORARY not in known}


def own_files(folder: Path) -> list[Path]:
    """Return the files in a folder that this program wrote, in order of their names."""
    return [folder / name for name in sorted(_read(folder)) if is_own(folder / name)]


def record(folder: Path, digests: Mapping[str, str]) -> None:
    """Add files to the manifest of a folder, by name, with their digests.

    Raises InputError if the file with the manifest's name was not written by correlograph.
    """
    manifest = folder / MANIFEST
    _read(folder)
    lines = b"".join(f"{digest}  ".encode() + _encode(name) + b"\n" for name, digest in digests.items())
    with open(manifest, "ab") as stream:
        stream.write(b"\n" + lines if stream.tell() else _HEADER + lines)  # the line before may be cut off


def record_temporary(path: Path) -> None:
    """Record in the manifest that a file or folder exists only during this run."""
    record(path.parent, {path.name: _TEMPORARY})


def remove_temporary(folder: Path, stem: str | None = None) -> None:
    """Remove what killed runs left in a folder: of outputs of one stem, or of all; what a running process writes stays."""
    for name, known in _read(folder).items():
        path, parts = folder / name, _PARTIAL_NAME.fullmatch(name)
        if _TEMPORARY not in known or parts is None or (stem is not None and not (parts["of"] or "").startswith(f"{stem}.")):
            continue
        if is_running(int(parts["process"])):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def is_running(process: int) -> bool:
    """Return whether another process of this number is running; False where the system does not tell."""
    if process == os.getpid() or os.name != "posix":
        return False
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def remove_unused_manifest(folder: Path, lock: str) -> None:
    """Remove the manifest of a folder that holds nothing else but a lock of this name."""
    if {path.name for path in folder.iterdir()} == {MANIFEST, lock}:
        (folder / MANIFEST).unlink()


def digest_of(path: Path) -> str:
    """Return the SHA-256 digest of a file, or of the names and files of a folder, as hexadecimal text."""
    if path.is_dir():
        inside = sorted(file for file in path.rglob("*") if file.is_file())
        lines = "".join(f"{digest_of(file)}  {file.relative_to(path)}\n" for file in inside)
        return hashlib.sha256(lines.encode("utf-8", "surrogateescape")).hexdigest()
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _read(folder: Path) -> dict[str, tuple[str, ...]]:
    """Return the digests of each name in the manifest, the latest last. Raises InputError for a foreign manifest."""
    try:
        state = os.lstat(folder / MANIFEST)
        if not stat.S_ISREG(state.st_mode) or state.st_size > MAX_MANIFEST_BYTES:
            found = f"a link, a device or a large file {folder / MANIFEST}"
            raise InputError("manifest", "a file that correlograph wrote", found, "move it")
        content = (folder / MANIFEST).read_bytes()
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise InputError("manifest", "a file that can be read", f"{folder / MANIFEST} ({error.strerror})", "move it") from None
    if content and not content.startswith(_HEADER):
        raise InputError("manifest", "a file that correlograph wrote", f"another file {folder / MANIFEST}", "move it")
    known: dict[str, tuple[str, ...]] = {}
    for line in content[len(_HEADER) :].splitlines():
        digest, _, name = line.partition(b"  ")
        text, kind = _decode(name), digest.decode("ascii", "replace")
        # A damaged or forged line must not lead to a file elsewhere.
        is_name = text not in ("", ".", "..") and "/" not in text and "\0" not in text and text == Path(text).name
        if is_name and (kind == _TEMPORARY or _DIGEST.fullmatch(kind)):
            known[text] = (*known.get(text, ()), kind)
    return known


def _encode(name: str) -> bytes:
    return os.fsencode(name).replace(b"\\", b"\\\\").replace(b"\n", b"\\n").replace(b"\r", b"\\r")


def _decode(name: bytes) -> str:
    parts = [part.replace(b"\\n", b"\n").replace(b"\\r", b"\r") for part in name.split(b"\\\\")]
    return os.fsdecode(b"\\".join(parts))
