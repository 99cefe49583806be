"""The photographed wall: its roughness, its albedo, what of it fills a pixel, and what hides it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image

pytest.importorskip("mitsuba")

from correlograph.errors import InputError
from radiometry.prediction import predict
from radiometry.transfer import subjective_modes
from scenes import scene_path
from sim.frame import Simulation
from sim.optics.detector_roughness import exact_image, gamma_image, oversampling
from sim.optics.other_light import Background, StrayLight
from sim.plan import Plan, Settings
from sim.plan_report import make_plan
from sim.recording import Recording


def modes_of(geometry) -> float:
    return subjective_modes(
        geometry.camera.pixel_pitch_m, geometry.camera.pupil_diameter_m, geometry.wavelength_m, geometry.camera.pupil_distance_m
    )


def relative_variance(simulation: Simulation, frames: int) -> float:
    """Return the variance over the squared mean of expected frames, averaged over the frames."""
    images = [simulation.expected_frame(3, number) for number in range(frames)]
    return float(np.mean([float(image.var() / image.mean() ** 2) for image in images]))


@pytest.mark.slow
def test_detector_roughness_has_the_statistics_of_the_pupil(scene):
    """Even illumination: relative variance 1 / M by brute force; by the Gamma shortcut; mean unchanged."""
    geometry = scene()
    factor = oversampling(geometry)
    assert factor == 3
    flat = torch.ones(514 * factor, 616 * factor, dtype=torch.complex64)
    images = [exact_image(flat, factor, geometry, np.random.default_rng(number)) for number in range(3)]
    measured = np.mean([float(image.var() / image.mean() ** 2) for image in images])
    dof = modes_of(geometry)
    assert measured == pytest.approx(1.0 / dof, rel=0.02)
    assert np.mean([float(image.mean()) for image in images]) == pytest.approx(1.0, abs=0.01)
    gamma = gamma_image(torch.ones(514, 616), geometry, np.random.default_rng(5))
    assert float(gamma.var()) == pytest.approx(1.0 / dof, rel=0.02)
    # negative-exponential subjective speckle where one pixel is far smaller than a grain
    fine = scene(('name="pupil_diameter" value="51.4286e-3"', 'name="pupil_diameter" value="2e-3"'))
    assert modes_of(fine) == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
def test_exact_and_gamma_roughness_agree_on_rendered_frames(scene):
    forced = (("detector_roughness", True),)
    exact = Simulation(scene(), Settings("field", 1e-2, "fresnel", None, forced))
    short = Simulation(scene(), Settings("statistical", 1e-2, "auto", None, forced))
    variances = [relative_variance(simulation, 5) for simulation in (exact, short)]
    assert variances[0] == pytest.approx(variances[1], rel=0.08)
    images = [Simulation(scene()).expected_frame(11, number) for number in range(6)]
    plain = np.mean([float(image.std() / image.mean()) for image in images]) ** 2
    assert variances[0] > plain + 0.2


@pytest.mark.slow
@pytest.mark.parametrize("modes", ["of a scanned spot", "of two polarisations"])
def test_more_modes_do_not_average_the_detector_roughness(scene, depolarising, modes):
    """The field is nearly uniform over the point spread function, so that one factor multiplies the light of all moments and
    polarisations, in the exact method as in the shortcut and in the prediction."""
    if modes == "of two polarisations":
        several = scene(depolarising)
    else:
        still = scene()
        speed = 1.5 * still.spot.diameter_m / still.camera.electronics.exposure_s
        several = replace(still, spot=replace(still.spot, scan_speed_m_s=speed))
        assert float(several.motion.transfer(np.zeros(1), np.zeros(1))[0]) < 0.5
    with_it, without = (
        Simulation(several, Settings("statistical", 1e-2, "auto", None, (("detector_roughness", on),))) for on in (True, False)
    )
    factor = with_it.expected_frame(3, 0) / without.expected_frame(3, 0)
    assert float(factor.var()) == pytest.approx(1.0 / modes_of(several), rel=0.03)
    exact = Simulation(several, Settings("field", 1e-2, "fresnel", None, (("detector_roughness", True),)))
    assert relative_variance(exact, 3) == pytest.approx(relative_variance(with_it, 3), rel=0.1)
    light = predict(several).terms.light
    added = relative_variance(with_it, 3) - relative_variance(without, 3)
    assert 2.0 * light.detector_speckle == pytest.approx(added, rel=0.15)


def test_detector_roughness_is_decided_by_the_tolerance(scene):
    assert not Simulation(scene()).effects["detector_roughness"].modelled
    assert Simulation(scene(), Settings(tolerance=1e-3)).effects["detector_roughness"].modelled
    plan = make_plan(scene(), 2, Settings(tolerance=1e-3, effects=(("detector_roughness", False),)))
    line = next(effect for effect in plan["effects"] if effect["name"] == "detector_roughness")
    assert not line["modelled"]
    assert line["why"].startswith("forced off")
    assert any("detector_roughness" in warning for warning in plan["warnings"])


@pytest.mark.slow
@pytest.mark.parametrize("settings", [Settings(), Settings("field", 1e-2, "fresnel", None, (("detector_roughness", True),))])
def test_detector_albedo_is_visible_under_the_speckle(scene, tmp_path, settings):
    """Four quarters of a painted wall: each as bright as its albedo, rows down and columns right, energy as the mean says."""
    geometry, albedo = painted(scene, tmp_path)
    assert geometry.light_path.detector_albedo == pytest.approx(albedo.mean(), rel=1e-5)
    simulation, even = (
        Simulation(geometry, settings),
        Simulation(geometry, replace(settings, effects=(*settings.effects, ("detector_texture", False)))),
    )
    assert simulation.effects["detector_texture"].modelled
    assert even.effects["detector_texture"].predicted_error == pytest.approx(albedo.std() ** 2 / albedo.mean() ** 2, rel=1e-4)
    pictures, bare = (sum(one.expected_frame(4, number) for number in range(2)).numpy() for one in (simulation, even))
    np.testing.assert_allclose(in_quarters(pictures) / in_quarters(bare), albedo / albedo.mean(), rtol=5e-3)
    assert Simulation(scene()).geometry.wall.texture is None


@pytest.mark.parametrize("light", ["lamp", "stray"])
def test_other_light_shows_the_paint_as_the_object_does(scene, tmp_path, light):
    geometry, albedo = painted(scene, tmp_path)
    simulation = Simulation(geometry, Settings(effects=(("shot_noise", False),)))
    of_object = simulation.expected_frame(4, 0).numpy()
    if light == "lamp":
        lit = replace(geometry, wall=replace(geometry.wall, ambient_irradiance=np.full((8, 8), 1e-9)))
        other = (
            Simulation(lit, Settings(effects=(("shot_noise", False), ("ambient", True)))).expected_frame(4, 0).numpy()
            - of_object
        )
    else:
        simulation._stray = StrayLight(None, Background(SimpleNamespace(share=3.0), 0.0))
        other = simulation.expected_frame(4, 0).numpy() - of_object
        assert other.mean() == pytest.approx(3.0 * simulation.mean_photoelectrons, rel=0.01)
    quarters = in_quarters(other)
    np.testing.assert_allclose(quarters / quarters.mean(), albedo / albedo.mean(), rtol=0.01)


def in_quarters(frame: np.ndarray) -> np.ndarray:
    """Return the sums of a frame (514, 616) over its quarters (2, 2), without their edges."""
    rows, columns = (slice(20, 237), slice(277, 494)), (slice(20, 288), slice(328, 596))
    return np.array([[frame[row, column].sum() for column in columns] for row in rows])


def painted(scene, folder):
    """Return the reference scene with four quarters painted on the photographed wall, and their albedos as the camera sees them."""
    quarters = np.array([[0.25, 0.5], [0.75, 1.0]])
    Image.fromarray(np.round(255 * quarters).astype(np.uint8)).save(folder / "paint.png")
    plain = '</transform>\n        <bsdf type="phase_screen">\n            <float name="height_rms" value="2e-6"/>\n'
    text = scene_path("corner_letter").read_text()
    wall = text[text.index('id="virtual_detector"') :]
    old = wall[: wall.index("<sensor")]
    paint = (
        '<texture type="bitmap" name="reflectance"><string name="filename" value="paint.png"/><boolean name="raw" '
        'value="true"/><string name="filter_type" value="nearest"/></texture>'
    )
    assert plain in old
    geometry = scene((old, old.replace('<spectrum name="reflectance" value="1"/>', paint)))
    # Columns run along the rectangle's u; rows down, against its v, along which bitmaps are laid from their first row.
    albedo = np.round(255 * quarters[::-1]) / 255
    return geometry, albedo


def test_saturation_is_predicted_and_clips(scene):
    """Negative-exponential speckle: the share exp(-full well / mean) of the pixels is full."""
    mean = Simulation(scene()).mean_photoelectrons
    full_well = 1.5 * mean
    geometry = scene(('<float name="pixel_pitch"', f'<float name="full_well" value="{full_well}"/><float name="pixel_pitch"'))
    simulation = Simulation(geometry, Settings(effects=(("shot_noise", False), ("pupil_and_pixel", False))))
    frames = np.stack([simulation.frame(3, number).numpy() for number in range(8)])
    assert frames.max() == pytest.approx(full_well, rel=1e-6)
    assert (frames >= 0.999 * full_well).mean() == pytest.approx(np.exp(-1.5), rel=0.05)
    bright = geometry.with_power(1e4 * geometry.light_path.power_w).with_electronics(full_well=1e4 * full_well)
    assert any("22.3 % of the pixels will saturate" in warning for warning in make_plan(bright, 1)["warnings"])


@pytest.mark.parametrize(
    ("values", "ceiling"),
    [
        ({"bits": 8, "gain": 2.0}, 510.0),
        ({"bits": 8, "gain": 2.0, "full_well": 300.0}, 300.0),
        ({"bits": 12, "gain": 3.0, "full_well": 1000.0}, 999.0),
        ({"full_well": 250.0}, 250.0),
        ({}, 0.0),
    ],
)
def test_the_largest_value_of_a_pixel(scene, values, ceiling):
    """A full well of 1000 electrons is read as 333 steps of 3. Light of a million times as much fills every pixel."""
    geometry = scene().with_electronics(**values)
    assert geometry.camera.electronics.ceiling == ceiling
    plan = Plan.of(geometry.with_exposure(1e6 * geometry.camera.electronics.exposure_s))
    recording = Recording(plan, 2)
    assert recording.saturation(recording.frame(0)) == (pytest.approx(1.0, abs=0.05) if ceiling else 0.0)


def test_a_wide_blur_does_not_bring_light_from_the_opposite_edge(scene):
    """A pupil whose blur is 40 pixels wide: first and last columns of 60 frames, which a border of 8 pixels would make alike by 0.7."""
    geometry = scene().with_camera(frame_shape=(300, 200))
    camera = geometry.camera
    pupil_m = geometry.wavelength_m * camera.pupil_distance_m / (40.0 * camera.pixel_pitch_m)
    simulation = Simulation(geometry.with_camera(pupil_diameter_m=pupil_m), Settings(effects=(("pupil_and_pixel", True),)))
    frames = np.stack([simulation.expected_frame(5, number).numpy() for number in range(60)])
    assert np.corrcoef(frames[:, :, 0].ravel(), frames[:, :, -1].ravel())[0, 1] < 0.3
    assert np.corrcoef(frames[:, :, 0].ravel(), frames[:, :, 10].ravel())[0, 1] > 0.6


def test_a_camera_that_sees_past_the_wall_is_refused(scene):
    pole = (
        '<shape type="rectangle" id="pole"><transform name="to_world"><scale x="0.0002" y="0.02"/>'
        '<rotate y="1" angle="180"/><translate x="-0.003" z="0.99"/></transform><bsdf type="diffuse"/></shape>'
    )
    with pytest.raises(InputError, match="% of them see something else"):
        scene(("</scene>", f"{pole}</scene>"))
