"""Folder of a capture. An interrupted run leaves either the previous capture intact or a marker file; a folder with this
marker is refused.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from correlograph.errors import InputError
from correlograph.files.manifest import MANIFEST, PARTIAL, claim, record, record_temporary, recorded
from correlograph.files.output import sole_writer

MOVING = ".capture-is-being-moved"
"""Marker file, present while a finished capture moves into its folder; if it remains, the folder holds parts of two captures."""


EMPTY_DIGEST = hashlib.sha256().hexdigest()
"""Digest of the empty marker file."""


def check_complete(folder: Path) -> None:
    """Refuse a folder that a killed run left between two captures."""
    if (folder / MOVING).exists():
        raise InputError(
            "capture",
            "a whole one",
            f"the remains of a run that was killed in {folder}",
            "render it again into the same folder",
        )


def frame_path(folder: Path, number: int) -> Path:
    return folder / f"frame_{number:04d}.exr"


def is_frame_name(name: str) -> bool:
    """Return whether a rendered frame has this name."""
    return re.fullmatch(r"frame_\d{4,}\.exr", name) is not None


@contextmanager
def stage_capture(folder: Path, frames: int, *, overwrite: bool = False) -> Iterator[Path]:
    """Create a hidden folder inside `folder` for a single writer, and remove it afterwards.

    Raises InputError for a user's files that have the names of the capture; with `overwrite`, they will be replaced.
    """
    with sole_writer(folder):
        present = [path.name for path in folder.iterdir() if is_frame_name(path.name)]
        new = [frame_path(folder, number).name for number in range(frames)]
        claim(folder, dict.fromkeys([*new, *present, "truth.npy", "sim.json", MOVING]), overwrite=overwrite)
        staging = folder / f"{PARTIAL}{os.getpid()}"
        record_temporary(staging)
        staging.mkdir()
        try:
            yield staging
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def replace_capture(staging: Path, folder: Path) -> None:
    """Move a finished capture into its folder, in place of the earlier one."""
    older = [path for path in folder.iterdir() if is_frame_name(path.name)]
    new = [path.name for path in staging.iterdir() if path.name != MANIFEST]
    claim(folder, [*new, *(path.name for path in older)])  # files may have appeared during the rendering
    record(folder, {MOVING: EMPTY_DIGEST, **recorded(staging)})
    (folder / MOVING).touch()
    (folder / "sim.json").unlink(missing_ok=True)
    for path in older:
        path.unlink()
    for path in sorted(staging.iterdir(), key=lambda p: p.name == "sim.json"):
        if path.name != MANIFEST:
            os.replace(path, folder / path.name)
    (folder / MOVING).unlink()
