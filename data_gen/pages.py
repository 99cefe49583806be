"""Pages of text in non-Latin scripts, as targets.

The training data contain no Latin letter and no digit, so that legible Latin text cannot come from a prior over letters.
"""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from correlograph.lags import OBJECT_SIDE
from data_gen.fonts import dejavu_sans
from data_gen.shapes import ALPHABET, FINE, FONTS, cell_means

MIN_LINE_LAGS, MAX_LINE_LAGS = 9.0, 40.0
"""Distance of the lines of a page, in lags."""

SCRIPTS = tuple(
    "".join(character for character in ALPHABET if low <= character <= high)
    for low, high in (("α", "ω"), ("Α", "Ω"), ("а", "я"), ("А", "Я"), ("א", "ת"))
)
"""Letters that are taken together: small and capital Greek, small and capital Cyrillic, Hebrew."""


def page(rng: np.random.Generator, side: int = OBJECT_SIDE) -> np.ndarray:
    """Return lines of random words that fill part of the window, straight or slightly turned; uint8 (side, side)."""
    full = side * FINE
    canvas = Image.new("L", (full, full))
    pen = ImageDraw.Draw(canvas)
    line = FINE * float(np.exp(rng.uniform(np.log(MIN_LINE_LAGS), np.log(min(MAX_LINE_LAGS, side / 2)))))
    font = dejavu_sans(max(8, int(line * rng.uniform(0.6, 0.85))), *FONTS[rng.integers(len(FONTS))])
    script = SCRIPTS[rng.integers(len(SCRIPTS))]
    width, height = full * rng.uniform(0.4, 0.9, 2)
    left, top = (full - width) / 2, (full - height) / 2
    for row in range(max(1, int(height / line))):
        text = ""
        while pen.textlength(text, font=font) < width:
            text += "".join(rng.choice(list(script), rng.integers(2, 8))) + " "
        while text and pen.textlength(text, font=font) > width:
            text = text[:-1]
        pen.text((left, top + line * (row + 0.5)), text, fill=255, font=font, anchor="lm")
    if rng.random() < 0.5:
        canvas = canvas.rotate(float(rng.normal(0.0, 8.0)), Image.Resampling.BILINEAR)
    return cell_means(canvas, rng)
