"""Scene -> geometry: numbers of the reference scene, axes, and clear refusals."""

import re

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")

import sim  # noqa: E402
from correlograph.errors import InputError  # noqa: E402
from radiometry.light_budget_rows import closed_form  # noqa: E402
from scenes import scene_path  # noqa: E402
from sim.plan_report import make_plan  # noqa: E402
from sim.scene_file import load_scene  # noqa: E402
from sim.scene_reader import read_geometry  # noqa: E402
from sim.scene_warnings import scene_warnings  # noqa: E402

LETTER_SCENE = scene_path("corner_letter")


def edited(tmp_path, *replacements: tuple[str, str]):
    """The reference scene with pieces of its XML replaced, loaded."""
    text = LETTER_SCENE.read_text()
    for old, new in replacements:
        assert re.search(old, text, re.S), f"{old} is not in the scene"
        text = re.sub(old, new, text, flags=re.S)
    (tmp_path / "scene.xml").write_text(text)
    (tmp_path / "F.png").write_bytes((LETTER_SCENE.parent / "F.png").read_bytes())
    return load_scene(tmp_path / "scene.xml")[0]


def test_the_reference_scene_is_the_papers_lab(letter_simulation):
    geometry = letter_simulation("F").geometry
    path = geometry.light_path
    assert path.source_to_object_m == pytest.approx(0.5, rel=1e-6)
    assert path.object_to_detector_m == pytest.approx(1.0, rel=1e-6)
    assert path.detector_to_pupil_m == pytest.approx(0.54, rel=1e-6)
    assert path.object_albedo_area_m2 == pytest.approx(0.2e-4, rel=0.04)
    assert geometry.camera.pixel_pitch_m == pytest.approx(6.9e-6)
    assert geometry.camera.frame_shape == (2056, 2464)
    for name in (
        "source_cosine",
        "object_cosine_in",
        "object_cosine_out",
        "detector_cosine_in",
        "detector_cosine_out",
        "pupil_cosine",
    ):
        assert getattr(path, name) >= 0.97
    budget = closed_form(path)
    assert budget.per_pixel_db == pytest.approx(-182.0, abs=1.5)
    assert budget.photoelectrons_per_frame_s == pytest.approx(2.7e6, rel=0.35)


@pytest.mark.slow
def test_definitions_move_the_scene(letter_simulation):
    path = letter_simulation("L", standoff="1.7", power="0.05", exposure="0.01").geometry.light_path
    assert path.object_to_detector_m == pytest.approx(1.7, rel=1e-6)
    assert path.detector_to_pupil_m == pytest.approx(0.54, rel=1e-6)
    assert path.power_w == 0.05


def test_the_letter_reads_correctly_in_the_frames_axes(letter_simulation):
    bitmap = np.asarray(mi.Bitmap(str(LETTER_SCENE.parent / "F.png"))).reshape(256, 256) / 255.0
    seen = letter_simulation("F").geometry.hidden_object.sample((1e-2 / 64, 1e-2 / 64), (64, 64)).albedo
    coarse = bitmap.reshape(64, 4, 64, 4).mean((1, 3))
    assert np.corrcoef(seen.ravel(), coarse.ravel())[0, 1] > 0.97
    assert np.corrcoef(seen[:, ::-1].ravel(), coarse.ravel())[0, 1] < 0.8


def test_camera_axes(letter_simulation):
    """The camera looks along +z with +y up: its right is -x, its down is -y; turned by 12 degrees, it spreads columns."""
    geometry = letter_simulation("F").geometry
    np.testing.assert_allclose(geometry.camera.right, [-1 / np.cos(np.deg2rad(12.0)), 0, 0], atol=1e-4)
    np.testing.assert_allclose(geometry.camera.down, [0, -1, 0], atol=1e-6)


def test_missing_pieces_are_named(tmp_path):
    for name in ("virtual_source", "virtual_detector", "hidden_object"):
        with pytest.raises(InputError, match=f"^{name}: "):
            read_geometry(edited(tmp_path, (f'id="{name}"', 'id="something"')))
    with pytest.raises(InputError, match=r"^laser: "):
        read_geometry(edited(tmp_path, (r"<emitter.*?</emitter>", "")))


def test_forgotten_optimize_flag_is_named(tmp_path):
    twin = '<shape type="cube" id="{}"><bsdf type="diffuse"/></shape>'
    text = LETTER_SCENE.read_text().replace("</scene>", twin.format("a") + twin.format("b") + "</scene>")
    (tmp_path / "scene.xml").write_text(text.replace('"F.png"', f'"{LETTER_SCENE.parent / "F.png"}"'))
    with pytest.raises(InputError, match="optimize=False"):
        read_geometry(mi.load_file(str(tmp_path / "scene.xml")))


def test_a_beam_that_misses_and_a_blocked_camera_are_errors(tmp_path):
    with pytest.raises(InputError, match="laser beam"):
        read_geometry(edited(tmp_path, ('target="0.1039558, 0, 0.4890738"', 'target="0.3, 0, 0.4890738"')))
    with pytest.raises(InputError, match=r"camera.*baffle"):
        read_geometry(edited(tmp_path, ('x="0.095" z="0.6"', 'x="-0.05" z="0.6"')))
    with pytest.raises(InputError, match=r"virtual_detector.*% of them see something else"):
        read_geometry(edited(tmp_path, ('<scale x="0.015" y="0.015"/>', '<scale x="0.007" y="0.015"/>')))


@pytest.mark.slow
def test_an_occluder_darkens_the_object(tmp_path, letter_simulation):
    whole = letter_simulation("F").geometry.light_path.object_albedo_area_m2
    # a plate half way to the wall hides whatever lies on one side of the axis
    plate = (
        '<shape type="rectangle" id="clutter"><transform name="to_world"><scale x="0.02" y="0.02"/>'
        '<translate x="0.02" z="0.3"/></transform></shape></scene>'
    )
    part = read_geometry(edited(tmp_path, ("</scene>", plate))).light_path.object_albedo_area_m2
    assert 0.1 * whole < part < 0.9 * whole


@pytest.mark.slow
def test_light_straight_from_the_source_is_reported(tmp_path, letter_simulation):
    assert letter_simulation("F").geometry.is_direct_path_blocked
    assert make_plan(letter_simulation("F").geometry, 2)["warnings"] == []
    no_baffle = (r'<shape type="rectangle" id="baffle">.*?</shape>', "")
    open_scene = read_geometry(edited(tmp_path, no_baffle))
    assert not open_scene.is_direct_path_blocked
    assert make_plan(open_scene, 2)["warnings"] == []  # the lit wall faces away from the observed one
    looks_at = '<lookat origin="0.1039558, 0, 0.4890738" target='
    facing = (looks_at + '"0, 0, 0"', looks_at + '"0, 0.6, 0.62"')
    assert read_geometry(edited(tmp_path, facing)).direct_light == 0.0
    open_scene = read_geometry(edited(tmp_path, facing, no_baffle))
    assert open_scene.direct_light > 0.0
    assert any("baffle" in warning for warning in scene_warnings(open_scene, (3e-4, 3e-4)))


@pytest.mark.slow
def test_unused_scene_content_is_reported(tmp_path):
    turned = ('<rotate z="1" angle="180"/>', '<rotate y="1" angle="180"/>')
    wide = ('<scale x="0.005" y="0.005"/>', '<scale x="0.012" y="0.012"/>')
    for change, word in ((turned, "none of its light"), (wide, "64 lags")):
        warnings = make_plan(read_geometry(edited(tmp_path, change)), 2)["warnings"]
        assert any(word in warning for warning in warnings), word


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ('name="spot_diameter" value="5e-3"', 'name="spot_diameter" value="0.1"', "edge of the laser beam"),
        ('name="width" value="2464"', 'name="width" value="100"', "film"),
        ('name="width" value="2464"/>', 'name="width" value="2464"/><integer name="crop_width" value="256"/>', "film"),
        ('<texture type="bitmap".*?</texture>', '<spectrum name="reflectance" value="2"/>', "albedo of at most 1"),
        ('<scale x="0.005" y="0.005"/>', '<scale x="0" y="0.005"/>', "hidden_object"),
        (
            '<float name="magnification"',
            '<float name="bits" value="1.5"/><float name="full_well" value="9"/><float name="magnification"',
            "bits",
        ),
    ],
)
def test_impossible_scenes_are_refused(tmp_path, old, new, name):
    with pytest.raises(InputError, match=name):
        read_geometry(edited(tmp_path, (old, new)))


def test_the_hash_speaks_of_content_not_of_names(tmp_path):
    def digest(**definitions: str) -> str:
        return load_scene(LETTER_SCENE, definitions)[1]

    same = {digest(), digest(albedo="F.png"), digest(albedo=str(LETTER_SCENE.parent / "F.png")), digest(exposure="0.125")}
    assert len(same) == 1
    assert len({*same, digest(albedo="R.png"), digest(exposure="0.5")}) == 3


@pytest.mark.slow
def test_an_object_too_large_for_the_frame_says_how_far_to_move(letter_simulation):
    with pytest.raises(InputError, match=r"0\.259 m or more"):
        letter_simulation("F", standoff="0.25")
    letter_simulation("F", standoff="0.27")


def test_a_mirror_smooth_object_is_refused(tmp_path):
    from sim.frame import Simulation

    text = scene_path("corner_letter").read_text()
    screen = text[text.index('id="hidden_object"') : text.index('id="virtual_detector"')]
    smooth = screen.replace('name="height_rms" value="2e-6"', 'name="height_rms" value="1e-8"')
    with pytest.raises(InputError, match="height_rms"):
        Simulation(read_geometry(edited(tmp_path, (re.escape(screen), smooth))))


def test_unknown_xml_parameters_stay_errors(tmp_path):
    with pytest.raises(InputError, match="wavelength"):
        edited(tmp_path, ('name="wavelength"', 'name="wavelenght"'))
    with pytest.raises(InputError, match="read_nois"):
        edited(tmp_path, ('<float name="magnification"', '<float name="read_nois" value="1"/><float name="magnification"'))
    with pytest.raises(InputError, match="pupil"):
        edited(tmp_path, ('<float name="pupil_diameter" value="51.4286e-3"/>', ""))


def test_mitsuba_renders_the_scene_file():
    assert sim.activate().endswith("ad_mono")
    scene = mi.load_file(str(LETTER_SCENE), exposure=0.125, optimize=False)
    first, again, other = (np.array(mi.render(scene, seed=seed)) for seed in (1, 1, 2))
    assert first.shape == (2056, 2464, 1)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
