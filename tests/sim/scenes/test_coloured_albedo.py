"""Coloured albedo: Mitsuba's luminance, and a note."""

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("mitsuba")

import correlograph as cg


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["png", "bmp"])
def test_a_coloured_albedo_is_its_luminance_and_a_note_says_so(tmp_path, capsys, suffix):
    """Red on blue, sRGB: luminances of 0.2126 and 0.0722 of the full level."""
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[..., 2] = 255
    picture[16:40, 20:50] = (255, 0, 0)
    Image.fromarray(picture).save(tmp_path / f"flag.{suffix}")
    scene = cg.load("corner_letter", albedo=str(tmp_path / f"flag.{suffix}"))
    said = capsys.readouterr().err
    assert "note: flag" in said
    assert "0.07 to 0.21" in said
    seen = scene.geometry.hidden_object.sample((150e-6, 150e-6), (80, 80)).albedo
    assert np.quantile(seen[seen > 0.0], 0.98) / np.median(seen[seen > 0.0]) == pytest.approx(0.2126 / 0.0722, rel=0.05)
    Image.fromarray(picture[..., 0]).save(tmp_path / "grey.png")
    cg.load("corner_letter", albedo=str(tmp_path / "grey.png"))
    assert capsys.readouterr().err == ""
