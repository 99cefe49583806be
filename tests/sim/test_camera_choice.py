"""Comparison of cameras: a replaced camera against a scene file with that camera, and the ranking."""

from dataclasses import replace

import pytest

pytest.importorskip("mitsuba")

from radiometry.camera_choice import Arrangement, arrangements, compare_cameras
from radiometry.cameras import Camera
from radiometry.light_budget_rows import light_budget
from radiometry.prediction import predict
from sim.plan import check

PLATE = (
    '<shape type="rectangle" id="clutter"><transform name="to_world"><scale x="0.003" y="0.004"/>'
    '<translate x="0.013" z="0.001"/></transform><bsdf type="diffuse"><spectrum name="reflectance" value="0.7"/>'
    "</bsdf></shape></scene>"
)
CAMERA = Camera("A", 5e-6, (600, 800), 1.5, 0.2, 20000.0, False, ((532e-9, 0.5),))


@pytest.mark.slow
def test_another_camera_is_that_of_another_scene_file(scene):
    """Other pixels, magnification, pupil, frame and electronics, in a scene with clutter."""
    geometry = scene(("</scene>", PLATE))
    other = Arrangement(0.4, 2, 0.03).apply(geometry, CAMERA)
    written = scene(
        ("</scene>", PLATE),
        ('"pixel_pitch" value="3.45e-6"', '"pixel_pitch" value="10e-6"'),
        ('"magnification" value="0.5"', '"magnification" value="0.4"'),
        ('"pupil_diameter" value="51.4286e-3"', '"pupil_diameter" value="30e-3"'),
        ('value="616"', 'value="400"'),
        ('value="514"', 'value="300"'),
        (
            '<float name="exposure"',
            '<float name="read_noise" value="3"/><float name="dark_current" value="0.8"/><float name="full_well" value="80000"/>'
            '<float name="quantum_efficiency" value="0.5"/><float name="exposure"',
        ),
    )
    assert other.camera.electronics == written.camera.electronics
    assert other.camera.frame_shape == written.camera.frame_shape == (300, 400)
    assert light_budget(other.light_path).per_pixel == pytest.approx(light_budget(written.light_path).per_pixel, rel=1e-3)
    assert other.other_light_share == pytest.approx(geometry.other_light_share, rel=1e-9)
    assert other.other_light_share == pytest.approx(written.other_light_share, rel=0.05)
    mine, theirs = predict(other), predict(written)
    assert mine.pitches_m == pytest.approx(theirs.pitches_m, rel=1e-6)
    assert mine.terms.floor_over_peak() == pytest.approx(theirs.terms.floor_over_peak(), rel=0.02)
    assert mine.detection(2) == pytest.approx(theirs.detection(2), rel=0.03)


def test_plans_are_ranked_and_impossible_ones_named(scene):
    noisy = replace(CAMERA, name="noisy", read_noise=8.0)
    plans, impossible = compare_cameras(scene(), [noisy, CAMERA], arrangements([1.0, 0.1]), check)
    assert [plan.camera for plan in plans] == ["A", "noisy"]
    assert plans[0].detection_s < plans[1].detection_s
    assert plans[0].correlation_s is None
    assert len(impossible) == 2
    assert all("50 um pixels" in line for line in impossible)


def test_a_stronger_laser_needs_a_proportionally_shorter_exposure(scene):
    """The detection depends on power and exposure only through their product, because there is no dark current."""
    camera = replace(CAMERA, dark_current=0.0)
    choices = arrangements([0.5], powers_w=[0.1, 0.4])
    weak, strong = sorted(compare_cameras(scene(), [camera], choices, check)[0], key=lambda plan: plan.arrangement.power_w)
    assert weak.detection_s == pytest.approx(4.0 * strong.detection_s, rel=0.01)
    assert strong.photoelectrons == pytest.approx(4.0 * weak.photoelectrons)


@pytest.mark.slow
def test_the_exposure_for_a_correlation_is_that_of_its_error(scene):
    plan = compare_cameras(scene(), [CAMERA], [Arrangement(0.5)], check, 3, lambda geometry, prediction: 0.7)[0][0]
    geometry = Arrangement(0.5).apply(scene(), CAMERA).with_exposure(plan.correlation_s / 3)
    assert predict(geometry).error(3) == pytest.approx(0.7, rel=0.01)


@pytest.mark.slow
def test_fields_need_the_stated_exposure(scene):
    """A prediction at the stated exposure has just the photons per grain that fields need, in cells of lambda z over the frame."""
    geometry = scene(("</scene>", "</scene>"))
    plans, _ = compare_cameras(geometry, [CAMERA], arrangements((0.4, 0.8)), check, frames=3)
    for plan in plans:
        other = plan.arrangement.apply(geometry, CAMERA)
        forecast = predict(other.with_exposure(plan.fields_s / 3)).forecast_fields(3)
        assert forecast.photons_per_grain == pytest.approx(forecast.needed_photons_per_grain, rel=0.02)
        rows, columns = (
            other.wavelength_m * other.distance_m / (side * pitch)
            for side, pitch in zip(other.camera.frame_shape, other.seen_pitch_m, strict=True)
        )
        assert plan.cells_m == pytest.approx((rows, columns))
