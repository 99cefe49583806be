"""Light and speckle of scenes that are not the flat letter: against closed forms, and a path tracer that shares no code."""

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")

import sim  # noqa: E402
from correlograph.errors import InputError  # noqa: E402
from correlograph.lags import LAGS, lag_grid  # noqa: E402
from radiometry.autocorrelation import PatchGrid, autocorrelate, smooth_by_window  # noqa: E402
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation  # noqa: E402
from radiometry.light_budget_rows import light_budget  # noqa: E402
from scenes import scene_path  # noqa: E402
from sim.backend.variant import llvm_major  # noqa: E402
from sim.frame import Simulation  # noqa: E402
from sim.plan import Settings  # noqa: E402
from sim.plan_report import disagreement, make_plan  # noqa: E402
from sim.scene_reader import read_geometry  # noqa: E402
from sim.transport.monte_carlo import estimate_throughput  # noqa: E402
from tests.sim.scenes.random_scenes import path_traced, random_scene  # noqa: E402

HALF_PLANE, RING = lag_grid(LAGS).half_plane, lag_grid(LAGS).ring

NEW_LLVM = pytest.mark.skipif((llvm_major() or 99) < 17, reason="spheres, masks and microfacets need libLLVM 17")
QUIET = (("shot_noise", False), ("other_light", False), ("detector_roughness", False))
RAW = (*QUIET, ("pupil_and_pixel", False))
HIDDEN = '<shape type="rectangle" id="hidden_object">'


def wrapped(simulation: Simulation, frames: int = 6) -> tuple[float, float]:
    """Correlation of a frame's first and last columns, and of its rows."""
    images = [simulation.expected_frame(2, number).numpy() - simulation.mean_photoelectrons for number in range(frames)]
    columns = np.mean([(image[:, 0] * image[:, -1]).mean() / image.var() for image in images])
    rows = np.mean([(image[0] * image[-1]).mean() / image.var() for image in images])
    return float(columns), float(rows)


@pytest.mark.parametrize("settings", [Settings(effects=QUIET), Settings("field", 1e-1, "fresnel", None, QUIET)])
def test_frames_do_not_wrap_round(letter_simulation, settings):
    simulation = Simulation(letter_simulation("F").geometry, settings)
    assert max(map(abs, wrapped(simulation, 8))) < 0.05


def test_a_whole_frame_as_one_patch_shows_the_window_smoothed_autocorrelation(scene):
    """No window is too large: the mean over many frames is r*r under the frame's own triangle, without a bias of its own."""
    geometry = scene()
    simulation = Simulation(geometry, Settings(effects=RAW))
    height, width = geometry.camera.frame_shape
    grid = PatchGrid(height, 1, 1, geometry.camera.frame_shape, width)
    frames = 60
    estimate, dof = estimate_autocorrelation((simulation.expected_frame(4, number) for number in range(frames)), grid)
    pitches = grid.lag_pitches_m(geometry.wavelength_m, geometry.distance_m, geometry.seen_pitch_m)
    albedo = geometry.hidden_object.sample((pitches[0] / 4, pitches[1] / 4), (512, 512)).albedo
    known = smooth_by_window(autocorrelate(albedo), 4, LAGS)
    shown = HALF_PLANE & (RING > 2) & (RING < LAGS) & (known > 0.05 * known.max())
    ratio = estimate[shown] / known[shown]
    gain = np.median(ratio)
    # Gamma noise of K = dof at each lag: its mean over the lags is known to a percent.
    assert abs(ratio.mean() / gain - 1.0) < 0.03
    assert (ratio / ratio.mean()).var() * dof == pytest.approx(1.0, abs=0.35)


def plates(first: str, second: str) -> tuple[str, str]:
    """Two plates of 3 mm in place of the letter, each with a transform of its own."""
    plate = (
        '<shape type="rectangle" id="hidden_object_{}"><transform name="to_world"><scale value="0.0015"/>{}</transform>'
        '<bsdf type="diffuse"><spectrum name="reflectance" value="0.8"/></bsdf></shape>'
    )
    return HIDDEN, plate.format(1, first) + plate.format(2, second) + HIDDEN.replace("hidden_object", "letter")


def test_parts_at_two_depths_are_as_bright_as_their_distances_say(scene):
    """Brightness goes by 1 / (d1 d2)^2 of each part; the letter that the plates replace is put far away."""
    far = ('<rotate z="1" angle="180"/>', '<rotate z="1" angle="180"/><translate x="0.5" z="-3"/>')
    geometry = scene(plates('<translate x="-0.004" z="0.2"/>', '<translate x="0.004" z="-0.2"/>'), far)
    pitch = geometry.hidden_object.extent_m[1] / 256
    weight = geometry.hidden_object.sample((pitch, pitch), (256, 256)).weight
    column = np.arange(256)
    # Columns run along -x: the near plate, at negative x, lies in the right half.
    parts = weight[:, column >= 128].sum(), weight[:, column < 128].sum()
    spot, wall = geometry.spot.centre, geometry.camera.centre
    expected = []
    for place in (np.array([-0.004, 0.0, 0.2]), np.array([0.004, 0.0, -0.2])):
        to_spot, to_wall = spot - place, wall - place
        cosines = to_spot[2] / np.linalg.norm(to_spot) * (to_wall[2] / np.linalg.norm(to_wall)) ** 2
        toward = -(place - spot) @ -geometry.spot.normal / np.linalg.norm(to_spot)
        expected.append(cosines * toward / (to_spot @ to_spot) / (to_wall @ to_wall))
    assert expected[0] / expected[1] > 10.0
    assert parts[0] / parts[1] == pytest.approx(expected[0] / expected[1], rel=0.02)
    assert not disagreement(geometry, estimate_throughput(geometry.hidden_object._scene, 2**18))


@NEW_LLVM
def test_light_of_a_sphere_matches_its_integral(scene):
    """15 mm across, against a sum over its surface in numpy; the flat closed form is a decibel off."""
    ball = (
        HIDDEN,
        '<shape type="sphere" id="hidden_object"><float name="radius" value="0.0075"/><bsdf type="diffuse">'
        '<spectrum name="reflectance" value="0.6"/></bsdf></shape><shape type="rectangle" id="letter">',
    )
    far = ('<rotate z="1" angle="180"/>', '<rotate z="1" angle="180"/><translate x="0.5" z="-3"/>')
    geometry = scene(ball, far)
    polar, azimuth = np.meshgrid((np.arange(800) + 0.5) / 800 * np.pi, (np.arange(800) + 0.5) / 400 * np.pi, indexing="ij")
    normal = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    area = np.sin(polar) * 0.0075**2 * (np.pi / 800) * (np.pi / 400)
    place, path = 0.0075 * normal, geometry.light_path
    to_spot, to_wall = geometry.spot.centre - place, geometry.camera.centre - place
    lit, seen = (np.clip((normal * way).sum(-1), 0.0, None) / np.linalg.norm(way, axis=-1) for way in (to_spot, to_wall))
    mean = (0.6 * area * lit * seen / (to_spot**2).sum(-1) / (to_wall**2).sum(-1)).sum()
    flat = 1.0 / (path.source_to_object_m * path.object_to_detector_m) ** 2
    ratio = mean / flat / (path.object_albedo_area_m2 * path.object_cosine_in * path.object_cosine_out)
    assert path.beyond_flat == pytest.approx(ratio, rel=5e-3)
    assert 10.0 * np.log10(path.beyond_flat) > 0.5


def grain_widths(geometry) -> list[float]:
    """Pixels down and right at which the speckle's covariance has fallen to half."""
    simulation = Simulation(geometry, Settings(effects=QUIET))
    images = [simulation.expected_frame(1, number).numpy() - simulation.mean_photoelectrons for number in range(8)]
    covariance = np.fft.ifft2(sum(np.abs(np.fft.fft2(image)) ** 2 for image in images)).real
    lines = (covariance[:, 0], covariance[0])
    return [float(np.interp(0.5, (line / line[0])[12::-1], np.arange(12, -1, -1))) for line in lines]


def test_a_camera_at_sixty_degrees_sees_twice_as_many_photons_and_grains_half_as_wide(scene):
    turned = ('<lookat origin="-0.1122723, 0, -0.5281997"', '<lookat origin="-0.4676537, 0, -0.27"')
    wide = ('<scale x="0.015" y="0.015"/>', '<scale x="0.05" y="0.05"/>')
    head_on, angled = scene(wide), scene(turned, wide)
    base, other = light_budget(head_on.light_path), light_budget(angled.light_path)
    cosines = np.cos(np.deg2rad(12.0)) / np.cos(np.deg2rad(60.0))
    # A pixel covers 1 / cos more of the wall, and the wall leaves cos less towards it.
    assert other.per_pixel / base.per_pixel == pytest.approx(1.0, abs=0.01)
    assert angled.light_path.pixel_area_m2 / head_on.light_path.pixel_area_m2 == pytest.approx(cosines, rel=1e-3)
    assert angled.seen_pitch_m[1] / angled.seen_pitch_m[0] == pytest.approx(2.0, rel=1e-3)
    widths, before = grain_widths(angled), grain_widths(head_on)
    assert widths[0] == pytest.approx(before[0], rel=0.08)
    assert widths[1] == pytest.approx(before[1] / cosines, rel=0.15)  # the pixel's own blur is a part of it


def test_clutter_in_the_laser_light_is_visible(scene):
    """A plate beside the letter brings as much light as it would as a second object; an even share is a closed form."""
    plate = (
        '<shape type="rectangle" id="{}"><transform name="to_world"><scale x="0.003" y="0.004"/>'
        '<translate x="0.013" z="0.001"/></transform><bsdf type="diffuse"><spectrum name="reflectance" value="0.7"/>'
        "</bsdf></shape></scene>"
    )
    alone, both = scene(), scene(("</scene>", plate.format("hidden_object_2")))
    cluttered = scene(("</scene>", plate.format("clutter")))
    expected = both.hidden_object.throughput / alone.hidden_object.throughput - 1.0
    assert cluttered.other_light_share == pytest.approx(expected, rel=0.03)
    assert alone.other_light_share < 1e-5
    simulation = Simulation(cluttered, Settings(effects=(("shot_noise", False),)))
    assert simulation.effects["other_light"].modelled
    frames = np.stack([simulation.expected_frame(0, number).numpy() for number in range(12)])
    assert frames.mean() / simulation.mean_photoelectrons == pytest.approx(1.0 + cluttered.other_light_share, rel=0.03)
    dark = Simulation(cluttered, Settings(effects=(("other_light", False),)))
    plan = make_plan(cluttered, 2, dark.settings)
    assert plan["other_light_by_shape"]["clutter"] == pytest.approx(1.0, abs=0.02)
    assert any("other_light" in warning and "by clutter" in warning for warning in plan["warnings"])


@pytest.mark.parametrize(
    ("surface", "word"),
    [
        ('<bsdf type="dielectric"/>', "transmits"),
        ('<bsdf type="thindielectric"/>', "mirror"),
        ('<bsdf type="conductor"/>', "mirror"),
        ('<bsdf type="plastic"/>', "mirror"),
        ('<bsdf type="diffuse"/><medium type="homogeneous" name="interior"/>', "medium"),
    ],
)
def test_unsupported_surfaces_are_refused_by_name(scene, surface, word):
    pane = (
        f'<shape type="rectangle" id="pane"><transform name="to_world"><scale value="0.01"/><translate x="0.3" z="0.2"/>'
        f"</transform>{surface}</shape></scene>"
    )
    with pytest.raises(InputError, match=rf"^pane: .*{word}"):
        scene(("</scene>", pane))


SCREEN = '<bsdf type="phase_screen">{}<float name="height_rms" value="2e-6"/><float name="correlation_length" value="1e-5"/>{}</bsdf>'
PLAIN = '<bsdf type="diffuse"/>'


@pytest.mark.parametrize(
    ("name", "bsdf", "word"),
    [
        ("hidden_object_2", f'<bsdf type="twosided">{SCREEN.format("", PLAIN)}</bsdf>', "inside another BSDF"),
        ("hidden_object_2", f'<bsdf type="mask">{SCREEN.format("", PLAIN)}</bsdf>', "inside another BSDF"),
        ("hidden_object_2", SCREEN.format("", SCREEN.format("", PLAIN)), "inside another BSDF"),
        (
            "hidden_object_2",
            SCREEN.format('<boolean name="depolarising" value="true"/>', PLAIN),
            "the whole hidden object depolarising",
        ),
        ("clutter", SCREEN.format('<vector name="velocity" x="0.01" y="0" z="0"/>', PLAIN), "a shape at rest"),
    ],
)
def test_phase_screens_that_would_be_ignored_are_refused(scene, name, bsdf, word):
    """Their roughness, motion and polarisation used to be dropped without a word."""
    place = '<transform name="to_world"><scale value="0.002"/><translate x="0.02"/></transform>'

    def with_square(surface: str):
        return scene(("</scene>", f'<shape type="rectangle" id="{name}">{place}{surface}</shape></scene>'))

    with_square(SCREEN.format("", PLAIN))
    with pytest.raises(InputError, match=word):
        with_square(bsdf)


@pytest.mark.slow
def test_traverse_changes_what_is_rendered(scene, tmp_path):
    scene()
    loaded = mi.load_file(str(tmp_path / "scene.xml"), optimize=False)
    integrator = mi.load_dict({"type": "speckle", "mean": True})
    first = np.array(mi.render(loaded, integrator=integrator, seed=1))
    values = mi.traverse(loaded)
    values["laser.power"] = 0.6
    values["virtual_detector.sensor.exposure"] = 0.25
    values.update()
    np.testing.assert_allclose(np.array(mi.render(loaded, integrator=integrator, seed=1)), 4.0 * first, rtol=1e-4)
    other = mi.load_dict({"type": "speckle", "mean": True, "frame": 1})
    assert not np.allclose(np.array(mi.render(loaded, integrator=other, seed=1)), 4.0 * first)
    values["laser.wavelength"] = 1550.0
    with pytest.raises(InputError, match="metres"):
        values.update()
    assert loaded.emitters()[0].wavelength_m == pytest.approx(532e-9)


def test_the_hash_knows_included_files(tmp_path):
    from sim.scene_file import load_scene

    text = scene_path("corner_letter").read_text().replace('"F.png"', f'"{scene_path("corner_letter").with_name("F.png")}"')
    baffle = text[text.index('<shape type="rectangle" id="baffle">') : text.rindex("</scene>")]
    (tmp_path / "scene.xml").write_text(text.replace(baffle, '<include filename="baffle.xml"/>'))
    digests = set()
    for height in ("0.05", "0.06"):
        (tmp_path / "baffle.xml").write_text(f'<scene version="3.0.0">{baffle.replace("0.05", height)}</scene>')
        digests.add(load_scene(tmp_path / "scene.xml")[1])
    assert len(digests) == 2


@NEW_LLVM
@pytest.mark.slow
def test_thirty_random_scenes_agree_with_the_mitsuba_path_tracer():
    """Budget, Monte Carlo and mean frame, each within three standard errors, or the scene is refused in one line."""
    scenes = [random_scene(seed) for seed in range(30)]
    refused, off = 0, []
    for scene, (expected, error) in zip(scenes, path_traced(scenes, 8192), strict=True):
        try:
            loaded = mi.load_string(scene.ours, optimize=False)
            simulation = Simulation(read_geometry(loaded), Settings(effects=(*QUIET,)))
        except InputError:
            refused += 1
            continue
        geometry = simulation.geometry
        budget = geometry.hidden_object.throughput * geometry.light_path.pixels
        sampled = estimate_throughput(loaded, 2**18)
        frames = [float(simulation.expected_frame(0, number).mean()) / simulation.mean_photoelectrons for number in range(40)]
        mean, spread = budget * np.mean(frames), budget * np.std(frames, ddof=1) / np.sqrt(40)
        own = 3e-3 * budget  # of the budget's own samples
        scores = [
            (budget - expected) / np.hypot(error, own),
            (sampled.per_frame - expected) / np.hypot(error, sampled.standard_error),
            (mean - expected) / np.sqrt(error**2 + own**2 + spread**2),
        ]
        if max(map(abs, scores)) > 3.0:
            off.append((scene.told, np.round(scores, 1)))
    assert refused <= 3
    assert len(off) <= 1, off  # of 90 scores, a quarter of one lies beyond three standard errors by chance


@pytest.mark.slow
def test_each_of_several_sensors_sees_its_own_frame(tmp_path):
    """A second camera of twice the transmission beside the first: the same speckle, twice the light."""
    text = scene_path("corner_letter").read_text().replace('value="2464"', 'value="616"').replace('value="2056"', 'value="514"')
    begin, end = text.index("<sensor"), text.index("</sensor>") + len("</sensor>")
    first = text[begin:end]
    dimmer = first.replace('<float name="pixel_pitch"', '<float name="transmission" value="0.5"/><float name="pixel_pitch"')
    assert dimmer != first
    (tmp_path / "scene.xml").write_text(text.replace("</scene>", f"{dimmer}</scene>"))
    (tmp_path / "F.png").write_bytes(scene_path("corner_letter").with_name("F.png").read_bytes())
    scene = sim.load(tmp_path / "scene.xml")
    with pytest.raises(InputError, match="exactly one speckle_camera"):
        sim.render(scene, frames=1)
    frames = [sim.render(scene.through(number), frames=1, seed=2, mean=True).frames[0] for number in (0, 1)]
    dim, bright = sorted(frames, key=np.mean)
    np.testing.assert_allclose(2.0 * dim, bright, rtol=1e-5)
    integrator = mi.load_dict({"type": "speckle", "mean": True})
    for number, frame in enumerate(frames):
        rendered = np.array(mi.render(scene.mitsuba, integrator=integrator, sensor=number, seed=2))[..., 0]
        np.testing.assert_allclose(rendered, frame, rtol=1e-5)
