"""Text as a test: character error rate of an ordinary OCR program on an albedo.

`tesseract` (Debian and conda package of this name) is optional; it reads Latin script, which the training data do not contain.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from correlograph.errors import InputError

ENLARGEMENT = 8
"""Pixels of the picture per lag; OCR expects letters of 20 to 40 pixels."""

MARGIN_LAGS = 4
"""Margin around the text, without which tesseract loses letters at the edge."""
BRIGHT_QUANTILE, TEXT_LEVEL = 0.995, 0.3
"""Quantile of the albedo that is black in the picture, and level above which there is text."""


def character_error_rate(reference: str, found: str) -> float:
    """Return the edit distance (Levenshtein) of two texts over the length of the reference, spaces and line ends included."""
    row = list(range(len(found) + 1))
    for number, expected in enumerate(reference, 1):
        before, row[0] = row[0], number
        for place, character in enumerate(found, 1):
            before, row[place] = row[place], min(row[place] + 1, row[place - 1] + 1, before + (expected != character))
    return row[-1] / max(len(reference), 1)


def read_text(albedo: np.ndarray, pixels_per_lag: int = 1) -> str:
    """Return the text that tesseract reads in an upright albedo. Raises InputError if it is not installed."""
    program = shutil.which("tesseract")
    if program is None:
        raise InputError("tesseract", "the program for optical character recognition", "none", "install tesseract-ocr")
    with TemporaryDirectory() as folder:
        picture = Path(folder) / "page.png"
        _dark_on_bright(albedo, pixels_per_lag).save(picture)
        done = subprocess.run([program, picture, "-", "--psm", "6"], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def _dark_on_bright(albedo: np.ndarray, pixels_per_lag: int) -> Image.Image:
    """Return an enlarged picture of the text in an albedo, dark on bright."""
    margin, enlargement = MARGIN_LAGS * pixels_per_lag, max(1, round(ENLARGEMENT / pixels_per_lag))
    shown = np.clip(albedo / max(float(np.quantile(albedo, BRIGHT_QUANTILE)), 1e-12), 0.0, 1.0)
    rows, columns = np.nonzero(shown > TEXT_LEVEL)
    if rows.size:
        shown = shown[
            max(rows.min() - margin, 0) : rows.max() + margin + 1,
            max(columns.min() - margin, 0) : columns.max() + margin + 1,
        ]
    grey = Image.fromarray(np.round(255.0 * (1.0 - shown)).astype(np.uint8))
    return grey.resize((grey.width * enlargement, grey.height * enlargement), Image.Resampling.BICUBIC)
