"""The sensor's stages are rendered, predicted and listed by one chain; predictions at another exposure are those of the scene there."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import correlograph as cg
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
from radiometry.noise.measured_noise import fit_known_signal, read_noise_level
from radiometry.prediction import predict
from radiometry.sensor import chain
from radiometry.sensor.photons import ShotNoise
from radiometry.sensor.stage import Stage
from sim.frame import Simulation
from sim.plan import Plan, Settings

NOISE = 0.4


class Flicker(Stage):
    """A toy stage: noise of two values, which the scene's read_noise enables."""

    name = "flicker"
    parameter = "read_noise"

    def record(self, electrons, electronics, rng):
        return electrons + np.float32(NOISE) * rng.choice(np.array([-1.0, 1.0], np.float32), electrons.shape)

    def variance(self, light, electronics):
        return NOISE**2


@pytest.fixture(scope="module")
def lab():
    """The reference scene with pixels twice as large."""
    geometry = cg.load("corner_letter").geometry
    return geometry.with_camera(pixel_pitch_m=2.0 * geometry.camera.pixel_pitch_m, frame_shape=(1028, 1232))


def measured(geometry, frames, seed=1):
    """Return floor over peak and K of an estimate from rendered frames."""
    prediction = predict(geometry)
    simulation = Simulation(geometry, Settings(effects=(("detector_roughness", True),)))
    seen = [simulation.frame(seed, number).numpy() for number in range(frames)]
    estimate, _ = estimate_autocorrelation(seen, prediction.grid)
    gain, floor = fit_known_signal(estimate, prediction.signal)
    return floor / gain, read_noise_level(estimate).dof


def test_a_new_stage_is_rendered_predicted_and_listed(lab, monkeypatch):
    """One file and one line: the toy stage follows read noise in the chain."""
    geometry = lab.with_electronics(read_noise=0.1)
    before = predict(geometry).floor_over_peak(2)
    monkeypatch.setattr(chain, "CHAIN", (*chain.CHAIN[:4], Flicker(), *chain.CHAIN[4:]))
    expected = predict(geometry).floor_over_peak(2)
    assert expected > 1.3 * before
    assert measured(geometry, 2)[0] == pytest.approx(expected, rel=0.1)
    effects = Plan.of(geometry).effects
    assert effects["flicker"].modelled
    assert "floor over peak" in effects["flicker"].why


@pytest.mark.parametrize("frames", [1, 3])
def test_a_fixed_pattern_raises_the_floor_of_one_frame_and_costs_others_a_frame(lab, frames):
    geometry = lab.with_electronics(fixed_pattern=3.0)
    prediction = predict(geometry)
    floor, dof = measured(geometry, frames)
    assert floor == pytest.approx(prediction.floor_over_peak(frames), rel=0.1)
    assert dof == pytest.approx(prediction.dof(frames), rel=0.15)
    assert prediction.dof(3) == pytest.approx(2.0 * predict(lab).dof(1))
    assert prediction.floor_over_peak(1) > 1.0 > 0.1 > prediction.floor_over_peak(3)


def test_a_weak_pattern_is_not_subtracted(lab):
    """Below the significance at which the estimator finds it, the pattern stays in the floor, and K is that of all frames."""
    geometry = lab.with_electronics(fixed_pattern=0.02)
    prediction = predict(geometry)
    assert prediction.dof(2) == predict(lab).dof(2)
    assert prediction.floor_over_peak(2) > predict(lab).floor_over_peak(2)


def test_row_noise_lies_on_one_axis_of_the_lags(lab):
    """Offsets of rows are constant along columns: s^2 times the columns of a patch, at lags of zero columns."""
    prediction = predict(lab.with_electronics(row_noise=0.5))
    rng = np.random.default_rng(2)
    rows, columns = lab.camera.frame_shape
    frames = [rng.poisson(3.0, (rows, columns)) + 0.5 * rng.standard_normal((rows, 1)) for _ in range(2)]
    estimate, _ = estimate_autocorrelation(frames, prediction.grid)
    middle = estimate.shape[0] // 2
    added = np.delete(estimate[:, middle], middle).mean() - 3.0
    light = prediction.terms.light
    expected = prediction.line_noise_over_peak()["row_noise"] * light.signal**2 * light.grain_pixels
    assert added == pytest.approx(expected, rel=0.2)
    assert np.delete(estimate[middle], middle).mean() == pytest.approx(3.0, rel=0.1)
    plan = Plan.of(prediction.geometry)
    assert "one axis" in plan.effects["row_noise"].why


def test_a_prediction_at_another_exposure_is_that_of_the_scene_there(lab):
    """Motion, gates and dark current change grain, transfer and floor with the exposure."""
    moving = replace(lab, spot=replace(lab.spot, scan_speed_m_s=0.05))
    gated = lab.with_electronics(gate=1e-4, dark_current=0.3)
    for geometry in (moving, gated):
        for exposure_s in (1e-3, 0.02, 3.0):
            asked, own = predict(geometry).at_exposure(exposure_s), predict(geometry.with_exposure(exposure_s))
            assert asked.terms == own.terms
            np.testing.assert_array_equal(asked.signal, own.signal)
    # A scanned spot gives independent patterns: over twice as many of them the speckle's variance halves. The subjective speckle of the
    # photographed wall stays and is the only noise in the end, so that an object is detected at half of the significance.
    long, longer = (predict(moving).at_exposure(seconds).detection(2) for seconds in (200.0, 400.0))
    assert longer == pytest.approx(0.5 * long, rel=0.02)


def test_the_advised_exposure_detects_or_none_is_advised(lab):
    scanned = replace(lab, spot=replace(lab.spot, scan_speed_m_s=0.05))
    for power, possible in ((0.3, True), (3e-4, False)):
        prediction = predict(scanned.with_power(power))
        exposure_s = prediction.detection_exposure_s(2)
        assert (exposure_s is not None) == possible
        if possible:
            assert predict(scanned.with_power(power).with_exposure(exposure_s)).detection(2) == pytest.approx(6.0, rel=0.01)


def test_extreme_exposures_have_the_limits_of_motion(lab):
    """A spot that moves by many diameters leaves a share of the speckle's variance that is inverse to the exposure."""
    moving = replace(lab, spot=replace(lab.spot, scan_speed_m_s=1.0))
    factors = [float(moving.with_exposure(seconds).motion.transfer(np.zeros(1), np.zeros(1))[0]) for seconds in (1e2, 1e4, 1e8)]
    assert factors[0] / factors[1] == pytest.approx(1e2, rel=1e-2)
    assert factors[1] / factors[2] == pytest.approx(1e4, rel=1e-2)


def test_shot_noise_is_a_stage_that_can_be_left_out(lab):
    silent = Simulation(lab, Settings(effects=(("shot_noise", False),)))
    np.testing.assert_array_equal(silent.frame(1, 0).numpy(), silent.expected_frame(1, 0).numpy())
    assert ShotNoise().is_set(lab.camera.electronics)


def test_documents_quote_the_light_budget_of_the_program():
    budget = cg.light_budget(cg.load("corner_letter"))
    root = Path(__file__).parents[2]
    rate = f"{budget.as_dict()['photoelectrons_per_frame_s'] / 1e6:.2f} million"
    for name in ("docs/commands.md", "docs/radiometry.md"):
        text = re.sub(r"<!--\w+-->", "", (root / name).read_text(encoding="utf-8"))
        assert f"{budget.per_pixel_db:.2f} dB" in text, name
        assert rate in text, name
        assert set(re.findall(r"-180\.\d+ dB", text)) == {f"{budget.per_pixel_db:.2f} dB"}
