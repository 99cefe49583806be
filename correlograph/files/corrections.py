"""Calibration frames of a camera: dark frame, flat-field frame and mask, applied to frames first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import Capture
from correlograph.files.file_frames import FileFrames
from correlograph.files.images import read_image
from correlograph.files.output import path_of

MAX_UNLIT_FRACTION = 0.01
"""Maximum fraction of pixels without light in the flat-field frame; they take the mean of the others."""

MIN_USED_FRACTION = 0.25
"""Minimum fraction of a frame that a mask must keep."""


@dataclass(frozen=True)
class Corrections:
    """Calibration files of the size of the frames; None for a missing one.

    Attributes:
        dark: frame without light; it is subtracted.
        flat: frame of uniform light; frames are divided by it (after subtraction of the dark frame and division by its mean).
        mask: image; where it is zero, pixels of a frame take the mean of the frame's other pixels.
    """

    dark: Path | str | None = None
    flat: Path | str | None = None
    mask: Path | str | None = None

    def __post_init__(self) -> None:
        """Raise InputError for names that are not paths."""
        for name, value in vars(self).items():
            if value is not None:
                path_of(name, value)

    def apply(self, capture: Capture) -> Capture:
        """Return the capture with corrected frames. Raises InputError for unsuitable files."""
        if self == Corrections():
            return capture
        change, measured = self._correction(capture.frames[0].shape)
        if capture.measured is not None:
            measured = capture.measured if measured is None else measured & capture.measured
        if isinstance(capture.frames, FileFrames):
            return replace(capture, frames=capture.frames.map(change), measured=measured)
        return replace(capture, frames=[change(frame) for frame in capture.frames], measured=measured)

    def _correction(self, shape: tuple[int, ...]) -> tuple[Callable[[np.ndarray], np.ndarray], np.ndarray | None]:
        """Return the correction of one frame, and the pixels that keep their own value, or None for all."""
        dark = _read("--dark", self.dark, shape) if self.dark else np.float32(0.0)
        lit = used = None
        gain = np.float32(1.0)
        if self.flat:
            flat = _read("--flat", self.flat, shape) - dark
            lit = flat > 0.0  # a pixel that is saturated in the dark frame is not
            if lit.mean() < 1.0 - MAX_UNLIT_FRACTION:
                raise InputError(
                    "--flat",
                    f"more light than the dark frame holds in all but {MAX_UNLIT_FRACTION:.0%} of the pixels",
                    f"{1.0 - lit.mean():.1%} without in {Path(self.flat).name}",
                    "use flat and dark frames of one exposure",
                )
            gain = np.where(lit, flat, flat[lit].mean()) / flat[lit].mean()
        if self.mask:
            used = _read("--mask", self.mask, shape) != 0.0
            if used.mean() < MIN_USED_FRACTION:
                raise InputError(
                    "--mask",
                    f"a mask that leaves {MIN_USED_FRACTION:.0%} of the pixels",
                    f"{used.mean():.1%} in {Path(self.mask).name}",
                    "zero pixels are left out; turn it round",
                )

        masks = [mask for mask in (lit, used) if mask is not None]
        return partial(_correct, dark, lit, gain, used), np.logical_and.reduce(masks) if masks else None


def _correct(
    dark: np.ndarray, lit: np.ndarray | None, gain: np.ndarray, used: np.ndarray | None, frame: np.ndarray
) -> np.ndarray:
    """Return a frame minus the dark frame, divided by the gain, with the mean in pixels that are not lit or not used."""
    frame = frame - dark
    if lit is not None:
        frame = np.where(lit, frame, frame[lit].mean()) / gain
    if used is not None:
        frame = np.where(used, frame, frame[used].mean())
    return frame.astype(np.float32, copy=False)


def _read(option: str, name: Path | str, shape: tuple[int, ...]) -> np.ndarray:
    file = Path(name)
    if not file.is_file():
        raise InputError(option, "a picture", f"no {file}", "check the path")
    pixels, _ = read_image(file, booleans=option == "--mask")
    if not np.isfinite(pixels).all():
        raise InputError(option, "finite pixels", f"NaN or infinity in {file.name}", "use another file")
    if pixels.shape != shape:
        raise InputError(option, f"the frames' size {shape}", pixels.shape, "use another file")
    return pixels
