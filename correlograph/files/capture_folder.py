"""Folder of a capture. An interrupted run leaves either the previous capture intact or a marker file; a folder with this
marker is refused.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from correlograph.errors import InputError
from correlograph.files.manifest import claim, record
from correlograph.files.output import replace_files, sole_writer, staging_folder

MOVED_TRUTH = "truth_frames.npy"
"""File of the truth in each frame of a scene that moves."""

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
        claim(folder, dict.fromkeys([*new, *present, "truth.npy", MOVED_TRUTH, "sim.json", MOVING]), overwrite=overwrite)
        with staging_folder(folder) as staging:
            yield staging


def replace_capture(staging: Path, folder: Path) -> None:
    """Move a finished capture into its folder, in place of the earlier one."""
    older = [path.name for path in folder.iterdir() if is_frame_name(path.name) or path.name == MOVED_TRUTH]
    record(folder, {MOVING: EMPTY_DIGEST})
    (folder / MOVING).touch()
    replace_files(staging, folder, older, "sim.json")
    (folder / MOVING).unlink()
