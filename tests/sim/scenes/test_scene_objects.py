"""Scenes as objects: text, copies, pickles, drawings, loaded captures, numbers as parameters."""

import copy
import pickle

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import correlograph as cg
from scenes import scene_path


@pytest.fixture(scope="module")
def scene():
    return cg.load("corner_letter", exposure=np.float64(0.25), power=np.float32(0.5))


def test_numpy_numbers_are_parameters_and_the_text_names_them(scene):
    assert "corner_letter" in repr(scene)
    assert "exposure=0.25" in repr(scene)
    assert scene.geometry.camera.electronics.exposure_s == 0.25
    with pytest.raises(cg.InputError, match="exposure"):
        cg.load("corner_letter", exposure=[0.1])
    with pytest.raises(cg.InputError, match="occluded_letter"):
        cg.load("corner_leter")


@pytest.mark.slow
def test_copies_and_pickles_are_the_same_scene(scene):
    for other in (copy.copy(scene), copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert (other.digest, other.parameters) == (scene.digest, scene.parameters)
        assert other.geometry.distance_m == scene.geometry.distance_m
    (swept,) = scene.sweep("exposure", [0.5])
    for other in (copy.copy(swept), copy.deepcopy(swept), pickle.loads(pickle.dumps(swept))):
        assert other.geometry.camera.electronics.exposure_s == 0.5


def test_instances_are_drawn_by_their_box(tmp_path):
    """Mitsuba draws no points on an instance, which ended rendering with a traceback."""
    group = '<shape type="shapegroup" id="group"><shape type="rectangle"><bsdf type="diffuse"/></shape></shape>'
    place = '<transform name="to_world"><scale value="0.003"/><translate x="0.05" y="0.02" z="0.5"/></transform>'
    instance = f'<shape type="instance" id="clutter">{place}<ref id="group"/></shape>'
    text = scene_path("corner_letter").read_text().replace("</scene>", f"{group}{instance}</scene>")
    (tmp_path / "scene.xml").write_text(text.replace("F.png", str(scene_path("corner_letter").with_name("F.png"))))
    above, _ = cg.load(tmp_path / "scene.xml").draw().axes
    assert "clutter" in {text.get_text() for text in above.texts}
    (tmp_path / "scene.xml").write_text((tmp_path / "scene.xml").read_text().replace('id="clutter"', 'id="hidden_object_2"'))
    with pytest.raises(cg.InputError, match="hidden_object_2: expected a shape, found an instance"):
        assert cg.load(tmp_path / "scene.xml").geometry


def test_the_drawing_shows_every_shape_to_scale(scene):
    figure = scene.draw()
    above, side = figure.axes
    for view in (above, side):
        assert view.get_aspect() == 1.0
        assert {"virtual_source", "virtual_detector", "hidden_object"} <= {text.get_text() for text in view.texts}
    beam = next(line for line in above.get_lines() if line.get_label() == "light by way of the object")
    length = np.hypot(*np.diff(np.array(beam.get_data()), axis=1))
    expected = scene.geometry.source_distance_m, scene.geometry.distance_m
    np.testing.assert_allclose(length, expected, rtol=1e-3)


def test_a_saved_capture_loads_as_it_was(tmp_path):
    capture = cg.render("corner_letter", frames=2, seed=3)
    capture.save(tmp_path)
    loaded = cg.Capture.load(tmp_path)
    assert all((one == other).all() for one, other in zip(loaded.frames, capture.frames, strict=True))
    assert (loaded.truth == capture.truth).all()
    assert loaded.camera == capture.camera
    assert "2 frames of 2056 x 2464 pixels" in repr(loaded)
    assert "<img" in loaded._repr_html_()


def test_a_sweep_equals_scenes_loaded_with_each_value(scene):
    swept = scene.sweep("exposure", np.array([0.125, 0.5]))
    loaded = cg.load("corner_letter", exposure=0.5, power=0.5)
    assert swept[1].digest == loaded.digest
    assert swept[1].plan().mean_photoelectrons == pytest.approx(loaded.plan().mean_photoelectrons, rel=1e-12)
    assert cg.predict(swept[1]).floor_over_peak == pytest.approx(cg.predict(loaded).floor_over_peak, rel=1e-12)
    assert cg.predict(swept[0]).floor_over_peak > cg.predict(swept[1]).floor_over_peak
    (brighter,) = swept[1].sweep("power", [1.0])
    assert brighter.geometry.camera.electronics.exposure_s == 0.5
    assert cg.light_budget(brighter).photoelectrons_per_pixel_s == pytest.approx(
        2.0 * cg.light_budget(swept[1]).photoelectrons_per_pixel_s
    )
    with pytest.raises(cg.InputError, match="exposure or power"):
        scene.sweep("standoff", [1.0])


@pytest.mark.slow
def test_frames_of_a_sweep_are_those_of_the_loaded_scene(scene):
    (swept,) = scene.sweep("exposure", [0.5])
    one = cg.render(swept, frames=1, seed=2).frames[0]
    other = cg.render(cg.load("corner_letter", exposure=0.5, power=np.float32(0.5)), frames=1, seed=2).frames[0]
    assert (one == other).all()
    (dark,) = scene.sweep("power", [0.0])
    assert dark.geometry.light_path.power_w == 0.0
    with pytest.raises(cg.InputError, match="exposure"):
        scene.sweep("exposure", [-1.0])
    with pytest.raises(cg.InputError, match="exposure"):
        scene.sweep("exposure", [1e14])[0].plan()
