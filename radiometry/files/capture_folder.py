"""The folder of a capture: an interrupted run leaves the previous capture intact."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path


def frame_path(folder: Path, number: int) -> Path:
    return folder / f"frame_{number:04d}.exr"


def staging_folder(folder: Path) -> Path:
    """A fresh hidden folder inside `folder`; those of runs that were killed are removed."""
    for left in folder.glob(".partial-*"):
        if left.is_dir():
            shutil.rmtree(left)
        else:
            left.unlink()
    staging = folder / f".partial-{os.getpid()}"
    staging.mkdir()
    return staging


def replace_capture(staging: Path, folder: Path) -> None:
    """Move a finished capture into its folder, in place of the one that sim.json describes.

    sim.json goes first and comes last: a folder without it holds no whole capture.
    """
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
    staging.rmdir()
