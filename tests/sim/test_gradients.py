"""Gradients of the expectation against finite differences, the expectation against the simulator's prediction, a pose found."""

import numpy as np
import pytest
import torch

pytest.importorskip("mitsuba")

from radiometry.light_budget_rows import light_budget
from radiometry.prediction import predict
from sim.gradients import expected_autocorrelation, mean_photoelectrons, setup_of, throughput

STEPS = {
    "tilt_right": 1e-5,
    "tilt_down": 1e-5,
    "shift_right_m": 1e-6,
    "shift_down_m": 1e-6,
    "source_m": 1e-6,
    "detector_m": 1e-6,
    "source_angle": 1e-5,
    "power_w": 1e-6,
    "wavelength_m": 1e-13,
    "pixel_pitch_m": 1e-12,
    "pupil_diameter_m": 1e-7,
    "exposure_s": 1e-6,
}


@pytest.fixture(scope="module")
def lab(request):
    from scenes import scene_path
    from sim.scene_file import load_scene
    from sim.scene_reader import read_geometry

    return read_geometry(load_scene(scene_path("corner_letter"), {"albedo": "R.png"})[0])


def test_expectation_agrees_with_the_simulator(lab):
    setup, prediction = setup_of(lab, 64), predict(lab)
    assert float(throughput(setup)) == pytest.approx(light_budget(lab.light_path).per_pixel, rel=5e-3)
    ours = expected_autocorrelation(setup).numpy()
    known = prediction.signal
    gain = (ours * known).sum() / (known * known).sum()
    assert np.linalg.norm(ours - gain * known) / np.linalg.norm(gain * known) < 0.02
    assert np.linalg.norm(ours[:, ::-1] - gain * known) > 3.0 * np.linalg.norm(ours - gain * known)


@pytest.mark.parametrize("name", STEPS)
def test_gradients_are_finite_differences(lab, name):
    base = setup_of(lab, 24).with_(tilt_right=0.2, tilt_down=-0.15, shift_right_m=1e-3, shift_down_m=-5e-4)
    weight = torch.from_numpy(np.random.default_rng(3).standard_normal((127, 127)))

    def loss(value: torch.Tensor) -> torch.Tensor:
        changed = base.with_(**{name: value})
        lags = expected_autocorrelation(changed)
        return (lags * weight).sum() / 1e4 + mean_photoelectrons(changed)

    value = getattr(base, name).clone().requires_grad_()
    loss(value).backward()
    step = STEPS[name]
    with torch.no_grad():
        numeric = (loss(value + step) - loss(value - step)) / (2.0 * step)
    assert float(value.grad) == pytest.approx(float(numeric), rel=1e-3)


def test_gradients_by_albedo(lab):
    base = setup_of(lab, 16)
    albedo = base.albedo.clone().requires_grad_()
    weight = torch.from_numpy(np.random.default_rng(3).standard_normal((127, 127)))
    (expected_autocorrelation(base.with_(albedo=albedo)) * weight).sum().backward()
    for cell in ((5, 7), (8, 4)):
        shifted = [base.albedo.clone() for _ in range(2)]
        shifted[0][cell] += 1e-4
        shifted[1][cell] -= 1e-4
        numeric = (
            sum(
                sign * float((expected_autocorrelation(base.with_(albedo=one)) * weight).sum())
                for sign, one in zip((1.0, -1.0), shifted, strict=True)
            )
            / 2e-4
        )
        assert float(albedo.grad[cell]) == pytest.approx(numeric, rel=1e-3)


@pytest.mark.slow
def test_pose_of_a_known_letter_is_found_from_two_frames():
    import sim
    from examples.plot_9_recover_pose import recover
    from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
    from radiometry.prediction import patches_of

    hidden = sim.load("tilted_letter", exposure=0.125, standoff=1.1, tilt=-30.0)
    estimate, dof = estimate_autocorrelation(sim.render(hidden, frames=2, seed=4).frames, patches_of(hidden.geometry)[0])
    facing = setup_of(sim.load("corner_letter", exposure=0.125).geometry, 32, patches_of(hidden.geometry)[0].size)
    distance, right, down = recover(estimate, dof, facing)
    assert distance == pytest.approx(1.1, rel=0.01)
    assert np.degrees(right) == pytest.approx(-30.0, abs=2.0)
    # A turn up or down by a few degrees shortens nothing: cos 3 degrees = 0.9986.
    assert abs(np.degrees(down)) < 10.0
