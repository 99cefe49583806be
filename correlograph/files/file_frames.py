"""The frames of a capture in files, read when they are needed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from pathlib import Path
from threading import Lock
from typing import Any, Protocol, overload

import numpy as np

from correlograph.files.exr_frames import FrameHeader
from correlograph.files.stacks import Frame, Stack

DIGEST_ROWS = 32
"""Number of rows of a frame that enter its digest."""


def frame_digest(pixels: np.ndarray) -> bytes:
    """Return a digest of a frame: SHA-256 of some rows and of the sum of all pixels as integers, which is fast."""
    words = np.ascontiguousarray(pixels, np.float32).view(np.uint32)
    rows = words[:: max(1, len(words) // DIGEST_ROWS)]
    return hashlib.sha256(rows.tobytes() + np.sum(words, dtype=np.uint64).tobytes()).digest()


class FrameCheck(Protocol):
    """Refuses frames that do not belong to one capture. It can be pickled."""

    def __call__(self, pixels: np.ndarray, header: FrameHeader | None, number: int, file: Path) -> None:
        """Raise InputError for a frame that does not fit those before."""

    def merge(self, other: Any) -> None:
        """Add what a copy of this check has learned from other frames. Raises InputError for a frame that both have seen."""


class FileFrames(Sequence[np.ndarray]):
    """Frames of several files in order, read when they are needed; iteration reads one ahead. Those of a part keep their numbers.

    Args:
        check: called with each frame that is read.
        change: called with each frame; returns the corrected frame, which replaces it.
    """

    def __init__(
        self,
        stacks: Sequence[Stack],
        check: FrameCheck,
        change: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> None:
        self.check, self._change, self._lock = check, change, Lock()
        places = [(stack, place) for stack in stacks for place in range(stack.count)]
        self._places = [(number, *one) for number, one in enumerate(places)]

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, number: int) -> np.ndarray: ...
    @overload
    def __getitem__(self, number: slice) -> FileFrames: ...
    def __getitem__(self, number: int | slice) -> np.ndarray | FileFrames:
        if isinstance(number, slice):
            part = copy(self)
            part._places = self._places[number]
            return part
        return self.read(range(len(self))[number])[0]

    def __iter__(self) -> Iterator[np.ndarray]:
        with ThreadPoolExecutor(1) as reader:
            following = reader.submit(self.read, 0)
            for number in range(1, len(self) + 1):
                frame, _ = following.result()
                if number < len(self):
                    following = reader.submit(self.read, number)
                yield frame

    def read(self, number: int) -> Frame:
        """Return a frame after checks and correction, and its header."""
        of_all, stack, place = self._places[number]
        with self._lock:  # not every decoder serves several threads
            pixels, header = stack.read(place)
        self.check(pixels, header, of_all, stack.path)
        return (pixels if self._change is None else self._change(pixels)), header

    def map(self, change: Callable[[np.ndarray], np.ndarray]) -> FileFrames:
        """Return the frames with a correction, which is applied when they are read."""
        changed = copy(self)
        changed._change = change
        return changed

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=Lock())
