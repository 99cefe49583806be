"""The drawing of a scene travels from the scene to the report; anything else in its place is ignored."""

import json

import pytest

import correlograph as cg
from correlograph.files.captured_frames import read_capture
from correlograph.files.drawing import SceneDrawing


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("capture")
    cg.render("occluded_letter", frames=1, seed=1).save(path)
    return path


@pytest.mark.slow
def test_the_report_draws_the_scene(folder):
    capture = read_capture([folder], cg.CameraMetadata())
    drawing = SceneDrawing.from_json(capture.record["drawing"])
    assert drawing is not None
    assert {"hidden_object", "virtual_detector", "bar", "laser beam"} <= {line.label for line in drawing.views[0]}
    assert SceneDrawing.from_json(json.loads(json.dumps(drawing.as_json()))) == drawing
    figure = cg.reconstruct(capture, quality="fast").plot()
    titles = [axes.get_title() for axes in figure.subfigs[-1].axes]
    assert titles == ["scene from above", "scene from the side"]


LINE = {"x": [0, 1], "y": [0, 1], "label": "a", "colour": "k", "style": "-", "width": 1, "is_filled": False}


@pytest.mark.parametrize(
    "drawing",
    [
        None,
        3,
        [],
        [[LINE]],
        [[LINE], [{**LINE, "x": "ab"}]],
        [[{**LINE, "x": [0, float("nan")]}], []],
        [[{**LINE, "style": "x"}], []],
        [[{**LINE, "colour": "file:///etc"}], []],
        [[{**LINE, "label": 3}], []],
        [[{"x": 1}], []],
    ],
)
def test_other_content_is_no_drawing(drawing):
    assert SceneDrawing.from_json(drawing) is None


@pytest.mark.parametrize("text", ["", "[]", "{", '{"drawing": 3}', "[" * 100_000])
def test_a_foreign_record_beside_frames_is_ignored(folder, tmp_path, text):
    (tmp_path / "frame_0000.exr").write_bytes((folder / "frame_0000.exr").read_bytes())
    (tmp_path / "sim.json").write_text(text)
    assert read_capture([tmp_path], cg.CameraMetadata()).record == {}
