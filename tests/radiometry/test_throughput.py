"""The closed-form light budget against cases with a known answer."""

from dataclasses import replace

import numpy as np
import pytest

from correlograph.errors import InputError
from radiometry.light_budget_rows import LightPath, closed_form
from radiometry.photons import grain_area, photon_rate

LAB = LightPath(
    wavelength_m=532e-9,
    power_w=0.3,
    source_albedo=1.0,
    source_cosine=1.0,
    source_to_object_m=0.5,
    object_cosine_in=1.0,
    object_albedo_area_m2=0.2e-4,
    object_cosine_out=1.0,
    object_to_detector_m=1.0,
    detector_cosine_in=1.0,
    detector_albedo=1.0,
    detector_cosine_out=1.0,
    detector_to_pupil_m=0.54,
    pupil_diameter_m=0.18 / 3.5,
    pupil_cosine=1.0,
    transmission=1.0,
    quantum_efficiency=1.0,
    pixel_area_m2=6.9e-6**2,
    pixels=2056 * 2464,
)


def test_the_papers_lab_reads_minus_180_6_db_per_pixel():
    assert closed_form(LAB).per_pixel_db == pytest.approx(-180.6, abs=0.1)
    assert closed_form(replace(LAB, detector_to_pupil_m=0.8)).per_pixel_db == pytest.approx(-184.1, abs=0.15)


def test_a_frame_gathers_its_pixels():
    budget = closed_form(LAB)
    assert budget.per_frame_db - budget.per_pixel_db == pytest.approx(67.05, abs=0.01)
    assert budget.photoelectrons_per_frame_s == pytest.approx(2.7e6, rel=0.35)


def test_laser_photons():
    assert photon_rate(0.3, 532e-9) == pytest.approx(8.0e17, rel=0.01)
    assert photon_rate(1.0, 1.0) == pytest.approx(1.0 / (6.62607015e-34 * 299792458.0))


@pytest.mark.parametrize(
    ("name", "factor", "gain"),
    [
        ("source_to_object_m", 0.5, 4.0),
        ("object_to_detector_m", 0.5, 4.0),
        ("detector_to_pupil_m", 0.5, 4.0),
        ("object_albedo_area_m2", 0.5, 0.5),
        ("source_albedo", 0.5, 0.5),
        ("detector_albedo", 0.25, 0.25),
        ("pupil_diameter_m", 0.5, 0.25),
        ("quantum_efficiency", 0.6, 0.6),
        ("object_cosine_in", 0.97, 0.97),
        ("power_w", 2.0, 1.0),
    ],
)
def test_scaling(name, factor, gain):
    changed = closed_form(replace(LAB, **{name: getattr(LAB, name) * factor}))
    assert changed.per_pixel / closed_form(LAB).per_pixel == pytest.approx(gain, rel=0.01)


def test_a_pupil_that_catches_everything_reads_0_db():
    all_caught = dict(closed_form(replace(LAB, pupil_diameter_m=1e9)).rows)["virtual detector to pupil"]
    assert 10 * np.log10(all_caught) == pytest.approx(0.0, abs=1e-6)


def test_rows_multiply_to_the_total_without_underflow():
    tiny = closed_form(replace(LAB, object_albedo_area_m2=1e-30, object_to_detector_m=1e6))
    assert sum(db for db in (row["db"] for row in tiny.as_dict()["rows"])) == pytest.approx(tiny.per_pixel_db)
    assert np.isfinite(tiny.per_pixel_db)


def test_a_black_object_is_dark_and_legal():
    budget = closed_form(replace(LAB, object_albedo_area_m2=0.0))
    assert budget.photoelectrons_per_frame_s == 0.0
    assert budget.as_dict()["per_frame_db"] is None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("power_w", -1.0),
        ("source_to_object_m", 0.0),
        ("wavelength_m", float("nan")),
        ("source_albedo", 1.5),
        ("object_cosine_in", -0.1),
    ],
)
def test_impossible_paths_are_refused(name, value):
    with pytest.raises(InputError, match=name):
        replace(LAB, **{name: value})


def test_grain_of_a_uniform_square_is_lambda_z_over_side_squared():
    albedo = np.zeros((40, 60))
    albedo[5:15, 20:45] = 0.3
    area = grain_area(albedo, 1e-4 * 2e-4, 500e-9, 2.0)
    assert area == pytest.approx((500e-9 * 2.0) ** 2 / (10 * 25 * 2e-8))
