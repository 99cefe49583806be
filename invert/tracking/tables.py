"""Check of the frames of paths, rotations and films, and the folder with table, numbers and plot in which each is saved."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from correlograph.errors import InputError, check_positive
from correlograph.files.capture import Capture
from correlograph.files.figures import save_figure
from correlograph.files.output import atomic, output_folder, save_json, sole_writer

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


def save_table(folder: str | Path, name: str, table: dict[str, np.ndarray], numbers: dict[str, Any], figure: Figure) -> Path:
    """Write NAME.csv with a column for each entry of a table, NAME.json and NAME.png; return the folder."""
    target = output_folder(str(folder))
    with sole_writer(target):
        with atomic(target / f"{name}.csv") as partial:
            np.savetxt(partial, np.column_stack([*table.values()]), "%.9g", ",", header=",".join(table), comments="")
        save_figure(target / f"{name}.png", figure)
        save_json(target / f"{name}.json", numbers)
    return target
