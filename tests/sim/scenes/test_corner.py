"""Scenes from a few numbers: the default is the reference lab; random ones have the distances that were asked for, and no direct light."""

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("mitsuba")

import correlograph as cg
from correlograph.cli import dispatch
from correlograph.errors import InputError
from scenes import scene_path
from scenes.corner import Corner


def load(corner: Corner, folder, aspect: float = 1.0):
    (folder / "scene.xml").write_text(corner.as_xml("object.png", aspect))
    return cg.load(folder / "scene.xml")


def test_the_default_is_the_reference_lab(tmp_path):
    (tmp_path / "object.png").write_bytes((scene_path("corner_letter").parent / "F.png").read_bytes())
    ours, reference = load(Corner(), tmp_path).geometry, cg.load("corner_letter").geometry
    for name in ("source_to_object_m", "object_to_detector_m", "detector_to_pupil_m", "pupil_diameter_m", "pixel_area_m2"):
        assert getattr(ours.light_path, name) == pytest.approx(getattr(reference.light_path, name), rel=1e-5)
    assert ours.light_path.object_albedo_area_m2 == pytest.approx(reference.light_path.object_albedo_area_m2, rel=1e-3)
    assert ours.seen_pitch_m == pytest.approx(reference.seen_pitch_m, rel=1e-6)
    assert ours.camera.frame_shape == reference.camera.frame_shape


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_random_corners_are_what_was_asked_for(tmp_path, seed):
    rng = np.random.default_rng(seed)
    corner = Corner(
        object_width_m=rng.uniform(2e-3, 0.02),
        source_distance_m=rng.uniform(0.3, 3.0),
        source_angle_deg=rng.uniform(15.0, 50.0),
        detector_distance_m=rng.uniform(0.6, 4.0),
        camera_angle_deg=rng.uniform(0.0, 40.0),
        frame_shape=(int(rng.integers(400, 700)), int(rng.integers(400, 700))),
        wall_albedo=rng.uniform(0.2, 1.0),
        read_noise=rng.uniform(0.1, 3.0),
        exposure_s=rng.uniform(0.01, 1.0),
    )
    albedo = np.zeros((40, 60), np.uint8)
    albedo[5:30, 10:20] = albedo[5:12, 10:50] = 255
    Image.fromarray(albedo).save(tmp_path / "object.png")
    geometry = load(corner, tmp_path, 40 / 60).geometry
    path = geometry.light_path
    # The centre of the object is that of its visible surface; its picture fills the rectangle.
    assert path.source_to_object_m == pytest.approx(corner.source_distance_m, rel=1e-4)
    assert path.object_to_detector_m == pytest.approx(corner.detector_distance_m, rel=1e-4)
    assert path.detector_to_pupil_m == pytest.approx(corner.camera_distance_m, rel=1e-4)
    assert path.source_albedo == pytest.approx(corner.wall_albedo, rel=1e-5)
    assert path.object_albedo_area_m2 == pytest.approx((albedo / 255.0).mean() * corner.object_width_m**2 * 40 / 60, rel=0.02)
    assert geometry.camera.electronics.read_noise == pytest.approx(corner.read_noise, rel=1e-6)
    assert geometry.camera.electronics.exposure_s == pytest.approx(corner.exposure_s, rel=1e-6)
    assert geometry.direct_light == 0.0
    assert np.degrees(np.arccos(path.object_cosine_in)) == pytest.approx(corner.source_angle_deg, abs=1.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("source_angle_deg", 1.0),
        ("detector_distance_m", -1.0),
        ("wall_albedo", 2.0),
        ("f_number", float("nan")),
        ("frame_shape", (0, 10)),
        ("source_angle_deg", "steep"),
        ("camera_angle_deg", 95.0),
    ],
)
def test_impossible_numbers_are_refused(name, value):
    with pytest.raises(InputError, match=name):
        Corner(**{name: value})


def test_whole_numbers_are_numbers():
    assert 'z="2"' in Corner(detector_distance_m=2, power_w=1).as_xml("object.png")


@pytest.mark.slow
def test_the_command_writes_a_scene_that_renders(tmp_path, command):
    picture = scene_path("corner_letter").parent / "7.png"
    arguments = [
        "new-scene",
        picture,
        "-o",
        tmp_path / "lab",
        "--pixels",
        400,
        500,
        "--source-distance-m",
        0.4,
        "--camera-angle-deg",
        0,
        "--read-noise",
        0,
    ]
    code, out, _ = command(dispatch, *arguments)
    assert code == 0
    assert "500 x 400 pixels" in out
    assert command(dispatch, *arguments)[0] == 0  # its own files are replaced
    capture = cg.render(cg.load(tmp_path / "lab" / "scene.xml"), frames=1, seed=1)
    assert capture.frames[0].shape == (500, 400)
    assert {path.name for path in (tmp_path / "lab").iterdir() if not path.name.startswith(".")} == {
        "scene.xml",
        "object.png",
        "scene.png",
    }
