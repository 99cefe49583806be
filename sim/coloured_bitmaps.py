"""Bitmaps of a scene: coloured ones, of which Mitsuba uses the luminance, and transparent ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from correlograph.errors import InputError

PICTURES = {".png", ".jpg", ".jpeg", ".bmp"}

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue (ITU-R BT.709)."""

MAX_DIFFERENCE = 2 / 255
"""Difference of the channels up to which a picture counts as grey."""


def check_opaque(files: Sequence[Path]) -> None:
    """Raise InputError for a picture with transparent pixels, which Mitsuba takes for opaque ones; unreadable files are left to Mitsuba."""
    from PIL import Image

    for file in (path for path in files if path.suffix.lower() in PICTURES):
        try:
            with Image.open(file) as picture:
                has_alpha = "A" in picture.getbands() or "transparency" in picture.info
                alpha = np.asarray(picture.convert("RGBA"))[..., 3] if has_alpha else np.full(1, 255, np.uint8)
        except (OSError, ValueError, Image.DecompressionBombError):
            continue
        if (alpha < 255).any():
            found = f"an alpha channel from {alpha.min()} to {alpha.max()}"
            raise InputError(file.name, "a picture without transparent pixels", found, "flatten it on black")


def describe_colours(files: Sequence[Path]) -> list[str]:
    """Return a note on each coloured picture, with the grey levels that take its place; unreadable files are left to Mitsuba."""
    from PIL import Image

    notes = []
    for file in dict.fromkeys(path for path in files if path.suffix.lower() in PICTURES):
        try:
            with Image.open(file) as picture:
                if picture.mode in ("1", "L", "LA", "I", "I;16", "F"):
                    continue
                pixels = np.asarray(picture.convert("RGB"), np.float32) / 255.0
        except (OSError, ValueError, Image.DecompressionBombError):
            continue
        if float(np.ptp(pixels, axis=-1).max()) > MAX_DIFFERENCE:
            linear = np.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4)  # sRGB, IEC 61966-2-1
            grey = linear @ np.array(LUMINANCE, np.float32)
            notes.append(
                f"{file.name} is coloured; its albedo is the luminance, {grey.min():.2f} to {grey.max():.2f}, the darkest colour included"
            )
    return notes
