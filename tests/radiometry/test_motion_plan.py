"""Plan for a moving object: limits, the error of rendered frames that follow it, and the bound of its path."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from correlograph.commands.exposure_plan import main
from correlograph.errors import InputError
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator
from radiometry.exposure_planner import measured_error
from radiometry.motion_plan import effective_groups, followed_error, kept_by_group, path_bound_m, plan_motion
from radiometry.prediction import predict
from sim.frame import Simulation
from sim.scene import load

VELOCITY = "9e-3, -4e-3, 0"


@pytest.fixture(scope="module")
def geometry():
    """A letter at 10 mm/s in frames of 1 ms, 400 x 500 pixels."""
    found = load("moving_letter", exposure=1e-3, velocity=VELOCITY).geometry.with_camera(frame_shape=(400, 500))
    return found.with_power(3.0)


def test_an_object_that_hardly_moves_is_one_long_exposure(geometry):
    slow = geometry.motion.lasting(1e-6)
    frame = predict(replace(geometry, movements=()))
    assert kept_by_group(slow, 8) == pytest.approx(1.0, abs=1e-4)
    assert effective_groups(slow, 8, 10) == pytest.approx(1.0, rel=1e-3)
    alone = frame.at_exposure(8e-3).error(1)
    # the wall's roughness is averaged while it passes
    assert followed_error(frame, slow, 8, 1) == pytest.approx(alone, rel=0.03)


def test_groups_that_share_nothing_are_independent(geometry):
    assert effective_groups(geometry.motion, 64, 10) == pytest.approx(10.0, rel=0.02)
    # alternating grains of 53 um: after a millimetre, hardly any contrast is left
    assert kept_by_group(geometry.motion, 100) < 0.1


@pytest.mark.slow
def test_rendered_frames_that_follow_the_object_have_the_predicted_error(geometry):
    """Within a fifth, for the pixels that are left of a group."""
    from correlograph.files.capture import Capture
    from invert.tracking.stabilise import stabilise
    from invert.tracking.track import Track

    count, simulation = 32, Simulation(geometry)
    frames = [simulation.frame(1, number).numpy() for number in range(count)]
    path = np.arange(count)[:, None] * (geometry.travel @ geometry.object_way_m)
    frame = predict(replace(geometry, movements=()))
    found = stabilise(Capture(frames), Track(path, np.ones(path.shape), 50.0, 1.0))
    for size, shown in ((1, frames), (found.size, found.capture.frames)):
        grid = replace(frame.grid, frame_shape=shown[0].shape)
        estimator = AutocorrelationEstimator(grid, mean="pooled")
        for one in shown:
            estimator.add(one)
        measured = measured_error(estimator.estimate(), frame)
        left = np.prod(shown[0].shape) / np.prod(frame.grid.frame_shape)
        expected = followed_error(frame, geometry.motion, size, len(shown)) / left**0.5
        assert expected == pytest.approx(measured, rel=0.2)
    assert found.size in (2, 4, 8)
    assert plan_motion(geometry, 32e-3).error < plan_motion(geometry, 32e-3).error_unfollowed


def test_the_bound_of_the_path_falls_with_the_light(geometry):
    frame = predict(replace(geometry, movements=()))
    faint, bright, group = (
        np.array(path_bound_m(one, size, geometry.travel))
        for one, size in ((frame, 1), (frame.at_exposure(4e-3), 1), (frame, 4))
    )
    assert 1e-8 < min(bright) < max(faint) < 5e-6
    assert faint / bright == pytest.approx([2.0, 2.0], rel=0.02)
    assert faint / group == pytest.approx([2.0, 2.0], rel=1e-6)
    noisy = frame.geometry.with_electronics(read_noise=2.0)
    faint, group = (np.array(path_bound_m(replace(frame, geometry=noisy), size, geometry.travel)) for size in (1, 4))
    assert faint / group == pytest.approx([2.0, 2.0], rel=1e-6)  # each frame has its own read noise


def test_the_exposure_suits_the_speed(geometry):
    slow = load("moving_letter", exposure=1e-3, velocity="9e-4, -4e-4, 0").geometry
    fast = load("moving_letter", exposure=1e-3, velocity=VELOCITY).geometry
    found = [plan_motion(one, 0.5) for one in (slow, fast)]
    assert found[0].exposure_s == pytest.approx(10.0 * found[1].exposure_s, rel=1e-6)
    assert found[0].error < found[1].error
    assert found[1].speed_m_s == pytest.approx(np.hypot(9e-3, 4e-3), rel=0.01)


def test_the_command_plans_a_moving_object(command, tmp_path):
    code, out, _ = command(main, "moving_letter", "--moving", "--budget-s", "0.5", "-o", tmp_path)
    assert code == 0
    assert "along its path" in out
    assert json.loads((tmp_path / "plan.json").read_text())["frames_per_group"] >= 1
    code, _, error = command(main, "corner_letter", "--moving", "--budget-s", "0.5")
    assert code == 2
    assert "--moving" in error
    code, _, error = command(main, "moving_letter", "--moving", "--fields-m", "1e-4")
    assert code == 2
    code, _, error = command(main, "moving_letter", "--moving", "--budget-s", "0.5", "-D", "angular_velocity=0,0,50")
    assert code == 2
    assert "does not turn" in error
    code, _, error = command(main, "moving_letter", "--moving", "--budget-s", "0.5", "-D", "velocity=0,0,1e-2")
    assert code == 2
    assert "across the line of sight" in error


def test_scenes_at_rest_are_refused():
    with pytest.raises(InputError, match="moves between frames"):
        plan_motion(load("corner_letter").geometry, 1.0)
