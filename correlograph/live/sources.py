"""Sources of frames for the live view. Anything with a `camera` that yields frames can take their place (`Frames`)."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata
from correlograph.files.captured_frames import by_number
from correlograph.files.stacks import is_stack, open_stack

if TYPE_CHECKING:
    from sim.recording import Recording

POLL_S = 0.2
"""Interval at which a folder or file is checked for new frames."""

PATIENCE_S = 5.0
"""Time for which an unreadable frame counts as one that is still being written."""


class Frames(Protocol):
    """Frames as a camera delivers them, in order: arrays (H, W) of one size."""

    camera: CameraMetadata

    def __iter__(self) -> Iterator[np.ndarray]: ...


@dataclass
class _Progress:
    """Progress of reading one file.

    Attributes:
        read: frames that were delivered or skipped.
        first: digest of the first frame; another one means that a new recording has replaced the file.
        settled: state of the file in which nothing is left to read.
        failing_since: when a frame could not be read for the first time.
    """

    read: int = 0
    first: bytes | None = None
    settled: tuple[int, int] | None = None
    failing_since: float | None = None

    @property
    def is_late(self) -> bool:
        """Whether an unreadable frame no longer counts as one that is still being written."""
        now = time.monotonic()
        self.failing_since = now if self.failing_since is None else self.failing_since
        return now - self.failing_since > PATIENCE_S


class GrowingFiles:
    """Frames of a folder to which files are added, or of one file that grows, until the reader stops.

    A frame that cannot be read within `PATIENCE_S` is skipped; `skipped` holds its file and the reason. A file whose first frame changes is
    read again from its start. While the folder or file is absent, `waiting` says so, and reading goes on when it is back.
    """

    def __init__(self, path: Path, camera: CameraMetadata) -> None:
        """Raise InputError for a path that does not exist."""
        if not path.exists():
            raise InputError("source", "a folder or a file of frames", f"none at {path}", "check the path")
        self.path, self.camera = path, camera
        self.skipped: list[str] = []
        self.waiting = ""
        self._progress: dict[Path, _Progress] = {}

    def __iter__(self) -> Iterator[np.ndarray]:
        while True:
            yielded = False
            for frame in self.poll():
                yielded = True
                yield frame
            if not yielded:
                time.sleep(POLL_S)

    def poll(self) -> Iterator[np.ndarray]:
        """Yield the frames that have arrived since the last call."""
        for file in self._files():
            yield from self._new_frames(file, self._progress.setdefault(file, _Progress()))

    def _files(self) -> list[Path]:
        try:
            if self.path.is_dir() and not is_stack(self.path):
                files = [file for file in self.path.iterdir() if is_stack(file) and not file.name.startswith(".")]
            else:
                files = [self.path]
            dated = sorted(files, key=lambda file: (file.stat().st_mtime_ns, by_number(file)))
        except OSError:  # deleted before, or while it was listed
            self.waiting = "" if self.path.exists() else f"nothing at {self.path}; reading goes on when it is back"
            return []
        self.waiting = ""
        return dated

    def _new_frames(self, file: Path, progress: _Progress) -> Iterator[np.ndarray]:
        is_open = False
        try:
            found = file.stat()
            # Arrays of a Zarr store grow in files of their own.
            state = (found.st_size, found.st_mtime_ns) if file.is_file() else None
            if state is not None and state == progress.settled:
                return
            stack = open_stack(file)
            if progress.first is not None and _digest(stack.read(0)[0]) != progress.first:
                progress.read = 0
            is_open = True
            while progress.read < stack.count:
                frame = stack.read(progress.read)[0]
                progress.first = _digest(frame) if progress.read == 0 else progress.first
                progress.read, progress.failing_since = progress.read + 1, None
                yield frame
        except FileNotFoundError:
            return  # `_files` reports it if it stays away
        except (InputError, OSError) as problem:
            if not progress.is_late:
                return
            self.skipped.append(f"{file.name}: {problem}")
            if is_open:
                progress.read += 1
                return
            progress.read, progress.first = 0, None
        progress.settled, progress.failing_since = state, None


def _digest(frame: np.ndarray) -> bytes:
    """Return a digest of every 64th pixel, which suffices to tell two exposures apart."""
    return hashlib.blake2b(np.ascontiguousarray(frame[::8, ::8]), digest_size=16).digest()


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
