"""Scenes at the limits of what frames and predictions can show are named."""

import pytest

pytest.importorskip("mitsuba")

import sim
from correlograph.errors import InputError
from scenes import scene_path
from sim.plan import Plan
from sim.plan_report import as_json
from sim.recording import Recording


@pytest.fixture(scope="module")
def geometry():
    return sim.load(scene_path("corner_letter")).geometry.with_camera(frame_shape=(192, 256))


def warned(geometry):
    return as_json(Plan.of(geometry), 2)["warnings"]


def test_an_object_within_a_grain_is_not_rendered(geometry):
    """Its extent is less than lambda z over the frame: 0.4 mm in the reference scene for 192 pixels."""
    small = geometry.with_object(geometry.hidden_object.cell_means(1.6e-4, 64), 3e-6)
    assert small.is_within_a_grain
    assert any("larger than the frame" in one for one in warned(small))
    with pytest.raises(InputError, match="hidden_object: expected an object with several grains"):
        Recording(Plan.of(small))
    assert not geometry.is_within_a_grain


def test_light_that_fills_the_sensor_is_named(geometry):
    assert not any("saturate" in one for one in warned(geometry.with_electronics(full_well=1000.0)))
    assert any("100 % of the pixels" in one for one in warned(geometry.with_electronics(full_well=1e3, dark_current=1e5)))
    bright = geometry.with_power(1e4).with_electronics(gate=geometry.camera.electronics.exposure_s)
    assert any("of the gates will count a photon" in one for one in warned(bright))


def test_a_blur_beyond_the_frame_is_named(geometry):
    assert not any("blurs by" in one for one in warned(geometry))
    assert any("blurs by" in one for one in warned(geometry.with_camera(pupil_diameter_m=1e-4)))


@pytest.mark.parametrize("gate", [1e-3, 1e-5])
def test_the_search_for_an_exposure_keeps_to_the_gates(geometry, gate):
    """An exposure holds one gate at least and 10^9 at most; the object is not detected within one."""
    counting = geometry.with_electronics(gate=gate, exposure_s=1.0)
    assert 1e-3 < Plan.of(counting).prediction.detection_exposure_s(2) < 1.0
    assert Plan.of(counting.with_power(1e-12)).prediction.detection_exposure_s(2) is None
