"""Predicted significance of a signal against that of rendered frames, and the exposure that detection needs."""

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from invert.measure.estimate import estimate_from_frames
from invert.measure.spectrum import read_measurement
from invert.request import Request
from radiometry.noise.detection import DETECTION_LIMIT
from radiometry.prediction import predict
from scenes import scene_path
from sim.rendering import render_geometry
from sim.scene_file import load_scene
from sim.scene_reader import read_geometry


def geometry_with(exposure_s: float, read_noise: float):
    geometry = read_geometry(load_scene(scene_path("corner_letter"))[0]).with_exposure(exposure_s)
    return geometry.with_electronics(read_noise=read_noise)


@pytest.mark.slow
@pytest.mark.parametrize(("exposure_s", "read_noise", "frames"), [(2e-3, 0.0, 1), (4e-3, 0.5, 3)])
def test_the_significance_of_rendered_frames_is_the_predicted_one(exposure_s, read_noise, frames):
    geometry = geometry_with(exposure_s, read_noise)
    prediction = predict(geometry)
    seen = []
    for seed in range(4):
        estimate = estimate_from_frames(render_geometry(geometry, frames, seed), Request(patch=prediction.grid.size, lags=63))
        seen.append(read_measurement(estimate.values).detection)
    assert np.mean(seen) == pytest.approx(prediction.detection(frames), rel=0.25, abs=1.5)


def test_the_detection_exposure_reaches_the_limit():
    """Read noise of 3 electrons: the significance is no power of the exposure."""
    prediction = predict(geometry_with(0.125, 3.0))
    for frames in (1, 50):
        exposure_s = prediction.detection_exposure_s(frames)
        assert prediction.at_exposure(exposure_s).detection(frames) == pytest.approx(DETECTION_LIMIT, rel=0.01)
