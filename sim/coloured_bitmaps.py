"""Coloured bitmaps of a scene, of which Mitsuba uses the luminance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

PICTURES = {".png", ".jpg", ".jpeg", ".bmp"}

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue (ITU-R BT.709)."""

MAX_DIFFERENCE = 2 / 255
"""Difference of the channels up to which a picture counts as grey."""


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
