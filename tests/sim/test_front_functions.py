"""The front functions take names, arrays and files, print pages, and refuse what cannot be meant."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import correlograph as cg
import radiometry
from invert.output.truth import Truth
from scenes import scene_path
from sim.plan_report import as_json


def test_a_name_is_as_good_as_a_scene():
    scene = cg.load("corner_letter")
    assert cg.predict("corner_letter").dof == cg.predict(scene).dof == radiometry.predict(scene.geometry).dof
    assert cg.light_budget("corner_letter").per_pixel == cg.light_budget(scene).per_pixel
    with pytest.raises(cg.InputError, match="scene"):
        cg.predict("no_such_scene")


@pytest.mark.slow
def test_plan_prediction_and_budget_print_pages_and_plot():
    scene = cg.load("corner_letter")
    for shown, word in (
        (scene.plan(), "photons per grain"),
        (cg.predict(scene), "floor over peak"),
        (cg.light_budget(scene), "per pixel"),
    ):
        assert word in str(shown)
        assert "array(" not in str(shown)
        assert word in shown._repr_html_()
    assert cg.predict(scene).plot().axes
    assert cg.light_budget(scene).plot().axes
    content = json.loads(json.dumps(as_json(scene.plan(), 3)))
    assert content["lag_pitches_m"] == pytest.approx(cg.predict(scene).pitches_m)
    assert len(content["grain_pixels"]) == len(content["patch_pixels"]) == 2
    assert content["dof"] == pytest.approx(cg.predict(scene, frames=3).dof)


def test_an_array_takes_the_place_of_a_bitmap():
    albedo = np.zeros((64, 64))
    albedo[10:50, 20:26] = 1.0
    albedo[10:16, 20:44] = 0.7
    scene = cg.load("corner_letter", albedo=albedo)
    assert scene.geometry.light_path.object_albedo_area_m2 == pytest.approx(albedo.mean() * 1e-4, rel=0.02)
    shown = scene.geometry.hidden_object.sample((1e-2 / 64, 1e-2 / 64), (64, 64)).albedo
    assert np.corrcoef(shown.ravel(), albedo.ravel())[0, 1] > 0.98
    assert pickle.loads(pickle.dumps(scene)).digest == scene.digest == cg.load("corner_letter", albedo=albedo).digest
    for wrong in (255.0 * albedo, -albedo, albedo[0], albedo * np.nan, albedo.astype(complex)):
        with pytest.raises(cg.InputError, match="albedo"):
            cg.load("corner_letter", albedo=wrong)


def test_frames_of_a_camera_are_a_capture(tmp_path):
    import tifffile

    pixels = np.random.default_rng(0).poisson(3.0, (200, 210)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "run1.tif", pixels)
    for source in (tmp_path / "run1.tif", tmp_path):
        np.testing.assert_array_equal(cg.Capture.load(source).frames[0], pixels)
    with pytest.raises(cg.InputError, match="capture"):
        cg.Capture.load(tmp_path / "absent")


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ((633, 10, 1.5), "wavelength_m"),
        ((10e-6, 633e-9, 1.0), "swapped"),
        ((532e-9, 1e-7, 1.0), "half a wavelength"),
        ((532e-9, 6.9, 1.0), "metres"),
    ],
)
def test_implausible_metadata_are_refused(values, word):
    with pytest.raises(cg.InputError, match=word):
        cg.CameraMetadata(*values)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('<float name="exposure"', '<float name="read_nois" value="1"/><float name="exposure"', "did you mean read_noise"),
        ('<float name="power"', '<float name="line_width" value="1e6"/><float name="power"', "did you mean linewidth"),
        ('"pixel_pitch" value="3.45e-6"', '"pixel_pitch" value="3.45"', "in metres on the sensor"),
    ],
)
def test_slips_of_a_scene_file_are_named(tmp_path, old, new, word):
    text = scene_path("corner_letter").read_text()
    assert old in text
    (tmp_path / "scene.xml").write_text(text.replace(old, new, 1))
    (tmp_path / "F.png").write_bytes(scene_path("corner_letter").with_name("F.png").read_bytes())
    with pytest.raises(cg.InputError, match=word):
        cg.load(tmp_path / "scene.xml").geometry  # noqa: B018 - the geometry is read when it is used


def test_a_truth_of_any_pitch_is_resampled(tmp_path):
    """A bitmap of 10 mm in 200 x 160 pixels on lags of 300 um: the light of each lag is the mean of its pixels."""
    picture = np.zeros((200, 160), np.float32)
    picture[60:120, 30:90] = 1.0
    np.save(tmp_path / "truth.npy", picture)
    known = Truth.read(tmp_path / "truth.npy", 50e-6).on_lags(64, (300e-6, 300e-6))
    assert known.sum() * 300e-6**2 == pytest.approx(picture.sum() * 50e-6**2, rel=1e-6)
    with pytest.raises(cg.InputError, match="truth"):
        Truth.read(tmp_path / "truth.npy")
