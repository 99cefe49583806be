"""Film of a live capture: its reconstructions in order, and the path of an object that moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from correlograph.errors import InputError
from invert.output.result import Result
from invert.tracking.track import Track
from invert.video.film import Film
from invert.video.sequence import register_sequence

MAX_IMAGES = 128
"""Number of images at which every second one is left out, and every second one that follows."""


@dataclass(frozen=True)
class Look:
    """A reconstruction, and the numbers of the frames that it is from, in order."""

    result: Result
    numbers: np.ndarray

    @property
    def middle(self) -> float:
        """Number of the frame at whose time it is: the middle of frames that follow an object, otherwise the latest."""
        return float(self.numbers.mean() if self.result.track is not None else self.numbers[-1])


@dataclass(frozen=True)
class _Image:
    """What a film keeps of a reconstruction."""

    albedo: np.ndarray
    confidence: float
    middle: float
    frames: int
    remarks: tuple[str, ...]


class LiveFilm:
    """Reconstructions so far, and the path through all of them."""

    def __init__(self) -> None:
        self._images: list[_Image] = []
        self._every, self._passed = 1, 0
        self._numbers = np.zeros(0)
        self._pitches_m: tuple[float, float] | None = None
        self.path: Track | None = None

    def add(self, look: Look) -> None:
        """Add a reconstruction that shows an object."""
        result = look.result
        if result.track is not None:
            self._extend(result.track, look.numbers)
        self._pitches_m = result.pitches_m
        self._passed += 1
        if self._images and self._passed < self._every:
            return
        self._passed = 0
        remarks = (*result.notes, *result.warnings)
        self._images.append(_Image(result.albedo, result.confidence, look.middle, len(look.numbers), remarks))
        if len(self._images) >= MAX_IMAGES:
            del self._images[1::2]  # the latest among them, which has passed
            self._passed, self._every = self._every, 2 * self._every

    def _extend(self, track: Track, numbers: np.ndarray) -> None:
        """Continue the path by one that overlaps with it. Without an overlap, path and film begin again."""
        if self.path is None or numbers[0] > self._numbers[-1]:
            self.path, self._numbers = track, numbers
            self._images, self._every, self._passed = [], 1, 0
            return
        known, seen = self.path, numbers <= self._numbers[-1]
        there = np.stack([np.interp(numbers[seen], self._numbers, axis) for axis in known.path_pixels.T], 1)
        moved = track.path_pixels + (there - track.path_pixels[seen]).mean(0)
        # From the last known position on, the errors of both add up.
        added = np.sqrt(np.maximum(track.error_pixels[~seen] ** 2 - track.error_pixels[seen][-1] ** 2, 0.0))
        self._numbers = np.concatenate([self._numbers, numbers[~seen]])
        self.path = replace(
            track,
            path_pixels=np.concatenate([known.path_pixels, moved[~seen]]),
            error_pixels=np.concatenate([known.error_pixels, np.hypot(added, known.error_pixels[-1])]),
        )

    def film(self, interval_s: float | None) -> Film:
        """Return the film so far; its frames are numbered from the first of the path. Raises InputError without an image.

        Args:
            interval_s: time between two frames; None if unknown.
        """
        if not self._images:
            raise InputError("images", "reconstructions that show an object", "none so far", "wait for one")
        first, path = 0.0, None
        if self.path is not None:
            first, every = self._numbers[0], np.arange(self._numbers[0], self._numbers[-1] + 1)
            places, errors = (
                np.stack([np.interp(every, self._numbers, axis) for axis in one.T], 1)
                for one in (self.path.path_pixels, self.path.error_pixels)
            )
            path = replace(self.path, path_pixels=places, error_pixels=errors, interval_s=interval_s)
        images = self._images
        return Film(
            albedos=register_sequence(np.stack([one.albedo for one in images])),
            middle_frame=np.array([one.middle - first for one in images]),
            confidence=np.array([one.confidence for one in images]),
            frames_per_image=round(float(np.mean([one.frames for one in images]))),
            path=path,
            pitches_m=self._pitches_m,
            interval_s=interval_s,
            notes=tuple(dict.fromkeys(remark for one in images for remark in one.remarks)),
        )
