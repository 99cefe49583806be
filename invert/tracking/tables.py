"""Check of the frames of paths, rotations and films, and the folder with table, numbers and plot in which each is saved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from correlograph.errors import InputError, check_positive
from correlograph.files.capture import Capture
from correlograph.files.figures import save_figure
from correlograph.files.output import atomic, output_folder, replace_files, save_json, sole_writer, staging_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def check_frames(capture: Capture, interval_s: float | None, least: int, purpose: str) -> None:
    """Raise InputError for anything else than a capture of `least` frames or more, and for an interval that is not positive or shorter
    than the exposure."""
    if interval_s is not None:
        check_positive("interval_s", interval_s)
    if not isinstance(capture, Capture):
        raise InputError("capture", "a Capture", f"{capture!r:.60}", "load it with correlograph.Capture.load")
    if len(capture.frames) < least:
        raise InputError("frames", f"{least} or more for a {purpose}", len(capture.frames), "provide more frames")
    exposure_s = exposure_of(capture)
    if interval_s is not None and exposure_s is not None and interval_s < 0.99 * exposure_s:
        expected = f"at least {exposure_s:g} s, the exposure of the frames"
        raise InputError("interval between frames", expected, f"{interval_s:g} s", "correct the frames per second")


def exposure_of(capture: Capture) -> float | None:
    """Return the exposure of a capture's frames in seconds; None if it is unknown."""
    return capture.headers[0].exposure_s if capture.headers else capture.file_metadata.exposure_s


def save_table(
    folder: str | Path,
    files: Sequence[str],
    content: tuple[dict[str, np.ndarray], dict[str, Any], Figure],
    write_more: Callable[[Path], None] = lambda staging: None,
) -> Path:
    """Write NAME.csv with a column for each entry of a table, NAME.json and NAME.png, which replace earlier ones as a whole; return the
    folder.

    Args:
        files: names of all files; the first one gives NAME.
        content: table, numbers and figure.
        write_more: writes the other files into a folder.
    """
    target, name, (table, numbers, figure) = output_folder(str(folder)), Path(files[0]).stem, content
    with sole_writer(target), staging_folder(target) as staging:
        with atomic(staging / f"{name}.csv") as partial:
            np.savetxt(partial, np.column_stack([*table.values()]), "%.9g", ",", header=",".join(table), comments="")
        save_figure(staging / f"{name}.png", figure)
        save_json(staging / f"{name}.json", numbers)
        write_more(staging)
        replace_files(staging, target, files, f"{name}.json")
    return target
