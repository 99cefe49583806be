"""A camera's own pictures: dark frame, flat field and mask, applied to frames before anything else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import Capture
from correlograph.files.images import read_image

MIN_USED_FRACTION = 0.25
"""Share of a frame that a mask must leave."""


@dataclass(frozen=True)
class Corrections:
    """Files of the frames' size; None for what there is not.

    Attributes:
        dark: frame without light, subtracted.
        flat: frame of even light; frames are divided by it, less the dark frame, over its mean.
        mask: picture whose zero pixels are left out: they take the mean of the others, and so tell nothing.
    """

    dark: Path | None = None
    flat: Path | None = None
    mask: Path | None = None

    def apply(self, capture: Capture) -> Capture:
        """The capture, its frames corrected. Raises InputError for files that do not fit."""
        if self == Corrections():
            return capture
        return replace(capture, frames=self._applied(capture.frames))

    def _applied(self, frames: Sequence[np.ndarray]) -> list[np.ndarray]:
        shape = frames[0].shape
        dark = _read("--dark", self.dark, shape) if self.dark else np.float32(0.0)
        corrected = [frame - dark for frame in frames]
        if self.flat:
            flat = _read("--flat", self.flat, shape) - dark
            if flat.min() <= 0.0:
                raise InputError(
                    "--flat",
                    "more light in every pixel than the dark frame holds",
                    f"{flat.min():g} in {self.flat.name}",
                    "give such pixels a value, and mask them",
                )
            corrected = [frame / (flat / flat.mean()) for frame in corrected]
        if self.mask:
            used = _read("--mask", self.mask, shape) != 0.0
            if used.mean() < MIN_USED_FRACTION:
                raise InputError(
                    "--mask",
                    f"a mask that leaves {MIN_USED_FRACTION:.0%} of the pixels",
                    f"{used.mean():.1%} in {self.mask.name}",
                    "zero pixels are left out; turn it round",
                )
            corrected = [np.where(used, frame, frame[used].mean()).astype(np.float32) for frame in corrected]
        return corrected


def _read(option: str, file: Path, shape: tuple[int, ...]) -> np.ndarray:
    if not file.is_file():
        raise InputError(option, "a picture", f"no {file}", "check the path")
    pixels, _ = read_image(file)
    if not np.isfinite(pixels).all():
        raise InputError(option, "finite pixels", f"NaN or infinity in {file.name}", "give another")
    if pixels.shape != shape:
        raise InputError(option, f"the frames' size {shape}", pixels.shape, "give another")
    return pixels
