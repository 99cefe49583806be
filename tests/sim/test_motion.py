"""Motion while the shutter is open, and from frame to frame, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from correlograph.errors import InputError
from correlograph.lags import LAGS, lag_grid
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
from radiometry.noise.measured_noise import fit_known_signal, read_noise_level
from radiometry.prediction import predict
from scenes import scene_path
from sim.frame import Simulation
from sim.optics.motion import correlation, sub_exposures, variance_lost_to_motion
from sim.plan import Settings
from sim.trajectory import Trajectory

HALF_PLANE = lag_grid(LAGS).half_plane

SPOT = '<float name="spot_diameter" value="5e-3"/>'
SCREEN = (
    'id="hidden_object">\n        <transform name="to_world">\n            <scale x="0.005" y="0.005"/>\n'
    '            <rotate z="1" angle="180"/>\n        </transform>\n        <bsdf type="phase_screen">'
)
BARE = Settings(effects=(("pupil_and_pixel", False), ("motion", True)))


def moving(x: float, y: float) -> tuple[str, str]:
    return SCREEN, f'{SCREEN}<vector name="velocity" x="{x}" y="{y}" z="0"/>'


def contrast_squared(simulation: Simulation, frames: int = 8) -> float:
    images = np.stack([simulation.expected_frame(5, number).numpy() for number in range(frames)])
    return float(np.mean([image.var() / image.mean() ** 2 for image in images]))


@pytest.mark.parametrize("grains", [0.5, 1.0, 3.0])
def test_a_moving_object_blurs_its_speckle(scene, grains):
    """Across the wall by u (1 + z / d1), of which a grain is lambda z / extent: contrast as the closed form says."""
    still = scene()
    exposure, grain = still.camera.electronics.exposure_s, still.wavelength_m * still.distance_m / 0.01
    speed = grains * grain / (1.0 + still.distance_m / still.source_distance_m) / exposure
    geometry = scene(moving(0.8 * speed, 0.6 * speed))
    simulation = Simulation(geometry, BARE)
    expected = 1.0 - variance_lost_to_motion(geometry, simulation.plan.samples)
    assert 0.05 < expected < 0.95
    assert contrast_squared(simulation) == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_a_travelling_spot_washes_its_speckle_out(scene, share):
    still = scene()
    speed = share * 5e-3 / still.camera.electronics.exposure_s
    geometry = scene((SPOT, f'{SPOT}<float name="scan_speed" value="{speed}"/>'))
    simulation = Simulation(geometry, BARE)
    # Overlap of two discs a way x of their diameter apart, squared; its mean under a triangle.
    x = (np.arange(4000) + 0.5) / 4000
    reduced = share * x
    overlap = 2.0 / np.pi * (np.arccos(reduced) - reduced * np.sqrt(1.0 - reduced**2))
    expected = 2.0 * np.mean((1.0 - x) * overlap**2)
    assert 1.0 - variance_lost_to_motion(geometry, simulation.plan.samples) == pytest.approx(expected, rel=2e-3)
    assert contrast_squared(simulation) == pytest.approx(expected, rel=0.1)


def test_frames_at_stated_times_show_the_same_speckle_moved(scene):
    """One wall lit twice while the object moves: the pattern travels along with it, by u (1 + z / d1), and decorrelates."""
    still = scene()
    shift_pixels = 6
    way = shift_pixels * still.seen_pitch_m[1] / (1.0 + still.distance_m / still.source_distance_m)
    interval = 10.0
    # Columns run along -x.
    step = f'{SPOT}<float name="scan_step" value="0"/>'
    camera = '<float name="pixel_pitch"'
    timed = f'<float name="frame_interval" value="{interval}"/>{camera}'
    geometry = scene(moving(-way / interval, 0.0), (SPOT, step), (camera, timed))
    simulation = Simulation(geometry, BARE)
    first, second = (simulation.expected_frame(3, number).numpy() for number in (0, 1))

    def likeness(columns: int) -> float:
        return float(np.corrcoef(first[:, 20:-20].ravel(), np.roll(second, -columns, 1)[:, 20:-20].ravel())[0, 1])

    found = max(range(-10, 11), key=likeness)
    assert found == shift_pixels
    left = correlation(geometry, simulation.plan.samples, interval) / abs_travel(simulation, interval)
    assert likeness(found) == pytest.approx(left, abs=0.08)


def abs_travel(simulation: Simulation, seconds: float) -> float:
    """The part of `correlation` that is travel alone: what remains of it at the place that the pattern has moved to is 1."""
    samples, geometry = simulation.plan.samples, simulation.geometry
    power = samples.amplitude.astype(np.float64) ** 2
    waves = geometry.motion.waves(*samples.coordinates_m.T) * seconds / geometry.camera.electronics.exposure_s
    return float((abs((power * np.exp(2j * np.pi * waves)).sum()) / power.sum()) ** 2)


@pytest.mark.parametrize("seed", range(3))
def test_camera_and_object_move_the_fringes_of_a_lag_together(scene, seed):
    """The closed form of a random motion of both, from their ways alone, against the paths of all samples. Before, forecasts left the
    camera out."""
    rng, still = np.random.default_rng(seed), scene()
    exposure, grain = still.camera.electronics.exposure_s, still.wavelength_m * still.distance_m / 0.01
    ways = rng.normal(size=(2, 3))
    camera, velocity = ways / np.linalg.norm(ways, axis=1)[:, None] * np.array([[0.4], [0.1]]) * grain / exposure
    moving_camera = replace(still.camera, trajectory=Trajectory(velocity_m_s=camera))
    geometry = replace(still.with_velocity(velocity), camera=moving_camera)
    simulation = Simulation(geometry, BARE)
    expected = abs_travel(simulation, exposure) * float(geometry.motion.correlation(1.0))
    assert 0.05 < expected < 0.95
    assert correlation(geometry, simulation.plan.samples, exposure) == pytest.approx(expected, rel=0.02)
    assert abs(abs_travel(Simulation(still.with_velocity(velocity), BARE), exposure) / expected - 1.0) > 0.03
    assert not geometry.at_rest.motion.moves


@pytest.mark.slow
@pytest.mark.parametrize(("grains", "spots"), [(0.0, 0.75), (1.0, 0.0), (3.0, 0.3)])
def test_floor_degrees_of_freedom_and_brightness_of_each_lag_are_as_predicted(tmp_path, grains, spots):
    """Whole frames of 1/32 s: gain, floor and K of the estimate, and its lags, which a moving object blurs unequally."""
    import sim

    exposure = 1 / 32
    still = sim.load("corner_letter", exposure=exposure).geometry
    grain = still.wavelength_m * still.distance_m / 0.01
    speed = grains * grain / (1.0 + still.distance_m / still.source_distance_m) / exposure
    text = scene_path("corner_letter").read_text()
    old, new = moving(0.8 * speed, 0.6 * speed)
    text = text.replace(old, new).replace(SPOT, f'{SPOT}<float name="scan_speed" value="{spots * 5e-3 / exposure}"/>')
    (tmp_path / "scene.xml").write_text(text)
    (tmp_path / "F.png").write_bytes(scene_path("corner_letter").with_name("F.png").read_bytes())
    geometry = sim.load(tmp_path / "scene.xml", exposure=exposure).geometry
    prediction, frames = predict(geometry), 3
    simulation = Simulation(geometry, Settings(effects=(("motion", True),)))
    assert simulation.plan.modes.sub_exposures > 1
    estimate, dof = estimate_autocorrelation((simulation.frame(3, number) for number in range(frames)), prediction.grid)
    gain, floor = fit_known_signal(estimate, prediction.signal)
    signal = prediction.terms.light.signal
    assert gain == pytest.approx(signal**2 * prediction.terms.light.grain_pixels, rel=0.05)
    assert floor / gain == pytest.approx(prediction.terms.floor_over_peak(), rel=0.15)
    assert read_noise_level(estimate).dof == pytest.approx(prediction.dof(frames), rel=0.1)
    assert prediction.dof(frames) == dof
    if grains:  # the lags of a scene at rest, fitted as well as can be, do not explain the estimate

        def misfit(signal: np.ndarray) -> float:
            a, b = fit_known_signal(estimate, signal)
            return float(np.mean((estimate / (a * signal + b) - 1.0)[shown] ** 2) * dof)

        at_rest = predict(still).signal
        shown = HALF_PLANE & (at_rest > 0.05)
        assert misfit(prediction.signal) < 1.2
        assert misfit(at_rest) > 1.25 * misfit(prediction.signal)


def test_motion_limits(scene):
    still = Simulation(scene())
    assert not still.effects["motion"].modelled
    assert variance_lost_to_motion(still.geometry, still.plan.samples) == 0.0
    fast = scene(moving(1.0, 0.0))
    with pytest.raises(InputError, match="grains in an exposure"):
        sub_exposures(fast, Simulation(fast, Settings(effects=(("motion", False),))).plan.samples, 1e-2)
