"""Film of a live capture: its reconstructions in order, and the path of an object that moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from correlograph.errors import InputError
from invert.output.result import Result
from invert.tracking.track import Track
from invert.video.film import Film
from invert.video.sequence import register_sequence
from invert.video.video import MAX_IMAGES

MAX_PATH = 4096
"""Number of the latest frames whose path is kept."""


@dataclass(frozen=True)
class Look:
    """A reconstruction and the numbers of the frames that follow an object, in order, or, if none moves, that of the latest frame."""

    result: Result
    numbers: np.ndarray

    @property
    def middle(self) -> float:
        """Number of the frame at whose time it is."""
        return float(self.numbers.mean())

    @property
    def frames(self) -> int:
        """Number of frames that it is from."""
        record = self.result.estimate.record
        return len(self.numbers) if self.result.track is not None or record is None else record.frames


@dataclass(frozen=True)
class _Image:
    """The part of a reconstruction that a film keeps."""

    albedo: np.ndarray
    confidence: float
    middle: float
    frames: int
    remarks: tuple[str, ...]


class LiveFilm:
    """Reconstructions so far, and the path through all of them. Images may be added while another thread asks for the film."""

    def __init__(self) -> None:
        self.path: Track | None = None
        self._lock = Lock()
        self._images: list[_Image] = []
        self._every, self._seen = 1, 0
        self._numbers = np.zeros(0)
        self._pitches_m: tuple[float, float] | None = None

    def add(self, look: Look) -> None:
        """Add a reconstruction that shows an object. With `MAX_IMAGES` images, every second one is left out, and of those that follow."""
        result = look.result
        remarks = (*result.notes, *result.warnings)
        image = _Image(result.albedo, result.confidence, look.middle, look.frames, remarks)
        with self._lock:
            if result.track is not None:
                self._extend(replace(result.track, others=()), look.numbers)
            self._pitches_m = result.pitches_m
            if self._seen % self._every == 0:
                self._images.append(image)
            self._seen += 1
            if len(self._images) >= MAX_IMAGES:
                del self._images[1::2]
                self._every *= 2

    def _extend(self, track: Track, numbers: np.ndarray) -> None:
        """Continue the path by one that agrees with it where they overlap. Otherwise, as where another object has become the brightest, it
        begins again."""
        known, seen = self.path, numbers <= (self._numbers[-1] if len(self._numbers) else -1)
        if known is None or not seen.any() or (away := self._away(track, numbers, seen)) is None:
            self.path, self._numbers = track, numbers
            return
        # From the last known position on, the errors of both add up.
        added = np.sqrt(np.maximum(track.error_pixels[~seen] ** 2 - track.error_pixels[seen][-1] ** 2, 0.0))
        path = np.concatenate([known.path_pixels, track.path_pixels[~seen] + away])[-MAX_PATH:]
        errors = np.concatenate([known.error_pixels, np.hypot(added, known.error_pixels[-1])])[-MAX_PATH:]
        self._numbers = np.concatenate([self._numbers, numbers[~seen]])[-MAX_PATH:]
        self.path = replace(track, path_pixels=path - path[0], error_pixels=errors)

    def _away(self, track: Track, numbers: np.ndarray, seen: np.ndarray) -> np.ndarray | None:
        """Return how far the start of a path lies from that of this one, (2,), by the frames that both have seen; None if they disagree."""
        assert self.path is not None
        there, error = (_at(numbers[seen], self._numbers, one) for one in (self.path.path_pixels, self.path.error_pixels))
        away = there - track.path_pixels[seen]
        limit = 1.0 + 5.0 * (error + track.error_pixels[seen])
        return None if (np.abs(away - away.mean(0)) > limit).any() else away.mean(0)

    def film(self, interval_s: float | None) -> Film:
        """Return the film so far. With a path, frames are numbered from its first, and images before it have no place. Raises InputError
        without an image.

        Args:
            interval_s: time between two frames; None if unknown.
        """
        with self._lock:
            images, numbers, path, first = list(self._images), self._numbers, self.path, 0.0
        if not images:
            raise InputError("images", "reconstructions that show an object", "none so far", "wait for one")
        if path is not None:
            first = numbers[0]
            path = replace(path, numbers=numbers - first, interval_s=interval_s)
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


def _at(wanted: np.ndarray, numbers: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values (frames, 2), known at some frames, at those wanted, by linear interpolation."""
    return np.stack([np.interp(wanted, numbers, axis) for axis in values.T], 1)
