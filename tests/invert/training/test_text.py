"""Character error rate, and OCR of albedos."""

import shutil

import numpy as np
import pytest
from PIL import Image, ImageDraw

from data_gen.fonts import dejavu_sans
from invert.evaluation.text import character_error_rate, read_text


@pytest.mark.parametrize(
    ("reference", "found", "distance"),
    [("abc", "abc", 0), ("abc", "", 3), ("abc", "xabc", 1), ("kitten", "sitting", 3), ("a b", "ab", 1), ("flaw", "lawn", 2)],
)
def test_character_errors_are_edits(reference, found, distance):
    assert character_error_rate(reference, found) == pytest.approx(distance / len(reference))


@pytest.mark.skipif(shutil.which("tesseract") is None, reason="tesseract is not installed")
def test_an_albedo_with_text_is_read():
    canvas = Image.new("L", (128, 128))
    ImageDraw.Draw(canvas).text((20, 40), "Hidden\ntext 42", fill=255, font=dejavu_sans(20))
    assert character_error_rate("Hidden\ntext 42", read_text(np.asarray(canvas, np.float32) / 255.0)) < 0.1
    assert read_text(np.zeros((64, 64), np.float32)) == ""
