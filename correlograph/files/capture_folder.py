"""Folder of a capture. An interrupted run leaves the previous capture intact, or a marker file that readers refuse."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from correlograph.errors import InputError
from correlograph.files.output import PARTIAL, sole_writer

MOVING = ".capture-is-being-moved"
"""Marker file, present while a finished capture moves into its folder; if it remains, the folder holds parts of two captures."""


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


@contextmanager
def stage_capture(folder: Path) -> Iterator[Path]:
    """Create a hidden folder inside `folder` for a single writer, and remove it afterwards."""
    with sole_writer(folder):
        staging = folder / f"{PARTIAL}{os.getpid()}"
        staging.mkdir()
        try:
            yield staging
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def replace_capture(staging: Path, folder: Path) -> None:
    """Move a finished capture into its folder, in place of the one that sim.json describes."""
    (folder / MOVING).touch()
    summary = folder / "sim.json"
    if summary.is_file():
        try:
            older = int(json.loads(summary.read_text())["frames"])
        except (ValueError, KeyError, TypeError):
            older = 0
        summary.unlink()
        for number in range(older):
            frame_path(folder, number).unlink(missing_ok=True)
    for path in sorted(staging.iterdir(), key=lambda p: p.name == "sim.json"):
        os.replace(path, folder / path.name)
    (folder / MOVING).unlink()
