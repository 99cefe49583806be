"""Sources of frames for the live view. Anything with a `camera` that yields frames can take their place (`Frames`)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata
from correlograph.files.stacks import is_stack, open_stack

if TYPE_CHECKING:
    from sim.recording import Recording

POLL_S = 0.2
"""Interval at which a folder or file is checked for new frames."""

PATIENCE_S = 5.0
"""Time for which an unreadable file counts as one that is still being written."""


class Frames(Protocol):
    """Frames as a camera delivers them, in order: arrays (H, W) of one size."""

    camera: CameraMetadata

    def __iter__(self) -> Iterator[np.ndarray]: ...


class GrowingFiles:
    """Frames of a folder to which files are added, or of one file that grows, until the reader stops.

    A file that cannot be read within `PATIENCE_S` is skipped; `skipped` holds its name and the reason.
    """

    def __init__(self, path: Path, camera: CameraMetadata) -> None:
        """Raise InputError for a path that does not exist."""
        if not path.exists():
            raise InputError("source", "a folder or a file of frames", f"none at {path}", "check the path")
        self.path, self.camera = path, camera
        self.skipped: list[str] = []
        self._known: dict[Path, int] = {}
        self._failing: dict[Path, float] = {}
        self._read_size: dict[Path, int] = {}

    def __iter__(self) -> Iterator[np.ndarray]:
        while True:
            yielded = False
            for file in self._files():
                for frame in self._new_frames(file):
                    yielded = True
                    yield frame
            if not yielded:
                time.sleep(POLL_S)

    def _files(self) -> list[Path]:
        if is_stack(self.path):
            return [self.path]
        visible = (file for file in self.path.iterdir() if is_stack(file) and not file.name.startswith("."))
        return sorted(visible, key=lambda file: (file.stat().st_mtime_ns, file.name))

    def _new_frames(self, file: Path) -> Iterator[np.ndarray]:
        """Yield the frames that a file has gained; after an unreadable frame, the file is tried again later from that frame."""
        size = file.stat().st_size
        if self._failing.get(file, 0.0) == float("inf") or (self._known.get(file, 0) and size == self._read_size.get(file)):
            return
        try:
            stack = open_stack(file)
            for number in range(self._known.get(file, 0), stack.count):
                frame = stack.read(number)[0]
                self._known[file] = number + 1
                yield frame
        except InputError as problem:
            first = self._failing.setdefault(file, time.monotonic())
            if time.monotonic() - first > PATIENCE_S:
                self._failing[file] = float("inf")
                self.skipped.append(f"{file.name}: {problem}")
        else:
            self._failing.pop(file, None)
            self._read_size[file] = size


class SimulatedCamera:
    """Frames of a scene, rendered as fast as a camera with a given frame rate delivers them, or as this machine can."""

    def __init__(self, recording: Recording, frames_per_s: float) -> None:
        self._recording, self._interval_s, self.camera = recording, 1.0 / frames_per_s, recording.camera

    def __iter__(self) -> Iterator[np.ndarray]:
        due, number = time.monotonic(), 0
        while True:
            frame = self._recording.frame(number)
            number += 1
            due = max(due + self._interval_s, time.monotonic() - self._interval_s)
            time.sleep(max(0.0, due - time.monotonic()))
            yield frame
