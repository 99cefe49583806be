"""The whole flow from Python, as a new user would write it."""

import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import invert
import radiometry
import sim
from correlograph.errors import InputError
from correlograph.files.exr_frames import read_frame
from scenes import scene_path


def test_five_lines(tmp_path):
    scene = sim.load("corner_letter", exposure=0.125)
    capture = sim.render(scene, frames=2, seed=1)
    result = invert.reconstruct(capture, method="classical")
    budget = radiometry.light_budget(scene)
    forecast = radiometry.predict(scene)

    assert result.object_found
    assert result.albedo.shape == (64, 64)
    assert budget.per_pixel_db == pytest.approx(-180.6, abs=0.1)
    assert (round(forecast.dof), forecast.signal.shape) == (325, (127, 127))
    assert forecast.floor_over_peak == pytest.approx(result.measurement.floor_over_peak, rel=0.4)
    assert capture.plan["propagator"] == "fraunhofer"
    summary = result.save(tmp_path / "result", truth=capture.truth)
    assert summary["pearson"] > 0.85
    # The files hold what the arrays hold, and comparing with a truth moves nothing.
    np.testing.assert_array_equal(np.load(tmp_path / "result" / "albedo.npy"), result.albedo)
    capture.save(tmp_path / "capture")
    pixels, header = read_frame(tmp_path / "capture" / "frame_0001.exr")
    np.testing.assert_array_equal(pixels, capture.frames[1])
    assert header.seed == 1
    again = invert.reconstruct(tmp_path / "capture", method="classical")
    np.testing.assert_array_equal(again.albedo, result.albedo)
    arrays = invert.reconstruct(np.stack(capture.frames), camera=capture.camera, method="classical")
    np.testing.assert_array_equal(arrays.albedo, result.albedo)


def test_scenes_come_as_names_files_dictionaries_and_scenes():
    import mitsuba as mi

    by_name, by_path = sim.load("corner_letter", power=0.1), sim.load(scene_path("corner_letter"), power=0.1)
    assert by_name.digest == by_path.digest
    loaded = mi.load_file(str(scene_path("corner_letter")), power=0.1, optimize=False)
    assert radiometry.light_budget(sim.load(loaded)).rows == radiometry.light_budget(by_name).rows
    values = mi.traverse(by_name.mitsuba)
    before = radiometry.light_budget(by_name).photoelectrons_per_pixel_s
    values["laser.power"] = 0.2
    values.update()
    assert radiometry.light_budget(by_name).photoelectrons_per_pixel_s == pytest.approx(2.0 * before)
    with pytest.raises(InputError, match="scene"):
        sim.load("no_such_scene")
    with pytest.raises(InputError, match="exposur"):
        sim.load("corner_letter", exposur=1.0)


def test_the_field_on_the_wall_is_to_be_had():
    field = sim.wall_field("corner_letter", seed=3)
    assert field.shape == (2056, 2464)
    assert np.iscomplexobj(field)
    assert float((np.abs(field) ** 2).mean()) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(
    ("package", "absent"), [("invert", ("mitsuba", "torch")), ("radiometry", ("mitsuba", "torch", "scipy"))]
)
def test_importing_a_package_costs_nothing_that_is_not_asked_for(package, absent):
    code = f"import sys, {package}; sys.exit(any(name in sys.modules for name in {absent}))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
