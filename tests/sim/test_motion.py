"""Motion while the shutter is open, and from frame to frame, against closed forms."""

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from radiometry.errors import InputError
from sim.frame import Simulation
from sim.motion import correlation, lost_variance, steps
from sim.plan import Settings

SPOT = '<float name="spot_diameter" value="5e-3"/>'
SCREEN = 'id="hidden_object">\n        <transform name="to_world">\n            <scale x="0.005" y="0.005"/>\n' \
         '            <rotate z="1" angle="180"/>\n        </transform>\n        <bsdf type="phase_screen">'
BARE = Settings(effects=(("pupil_and_pixel", False), ("motion", True)))


def moving(x: float, y: float) -> tuple[str, str]:
    return SCREEN, f'{SCREEN}<vector name="velocity" x="{x}" y="{y}" z="0"/>'


def contrast_squared(simulation: Simulation, frames: int = 8) -> float:
    images = np.stack([simulation.expected(5, number).numpy() for number in range(frames)])
    return float(np.mean([image.var() / image.mean() ** 2 for image in images]))


@pytest.mark.parametrize("grains", [0.5, 1.0, 3.0])
def test_a_moving_object_blurs_its_speckle(scene, grains):
    """Across the wall by u (1 + z / d1), of which a grain is lambda z / extent: contrast as the closed form says."""
    still = scene()
    exposure, grain = still.electronics.exposure_s, still.wavelength_m * still.distance_m / 0.01
    speed = grains * grain / (1.0 + still.distance_m / still.source_distance_m) / exposure
    geometry = scene(moving(0.8 * speed, 0.6 * speed))
    simulation = Simulation(geometry, BARE)
    expected = 1.0 - lost_variance(geometry, simulation.plan.samples)
    assert 0.05 < expected < 0.95
    assert contrast_squared(simulation) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_a_travelling_spot_washes_its_speckle_out(scene, share):
    still = scene()
    speed = share * 5e-3 / still.electronics.exposure_s
    geometry = scene((SPOT, f'{SPOT}<float name="scan_speed" value="{speed}"/>'))
    simulation = Simulation(geometry, BARE)
    # Overlap of two discs a way x of their diameter apart, squared; its mean under a triangle.
    x = (np.arange(4000) + 0.5) / 4000
    reduced = share * x
    overlap = 2.0 / np.pi * (np.arccos(reduced) - reduced * np.sqrt(1.0 - reduced**2))
    expected = 2.0 * np.mean((1.0 - x) * overlap**2)
    assert 1.0 - lost_variance(geometry, simulation.plan.samples) == pytest.approx(expected, rel=2e-3)
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
    first, second = (simulation.expected(3, number).numpy() for number in (0, 1))

    def likeness(columns: int) -> float:
        return float(np.corrcoef(first[:, 20:-20].ravel(), np.roll(second, -columns, 1)[:, 20:-20].ravel())[0, 1])

    found = max(range(-10, 11), key=likeness)
    assert found == shift_pixels
    left = correlation(geometry, simulation.plan.samples, interval) / abs_travel(simulation, interval)
    assert likeness(found) == pytest.approx(left, abs=0.08)


def abs_travel(simulation: Simulation, seconds: float) -> float:
    """The part of `correlation` that is travel alone: what remains of it at the place that the pattern has moved to is 1."""
    from sim.motion import _bending, _object_speed

    samples, geometry = simulation.plan.samples, simulation.geometry
    power = samples.amplitude.astype(np.float64) ** 2
    waves = samples.coordinates_m @ (np.array(_object_speed(geometry)) * seconds) * _bending(geometry) / geometry.wavelength_m
    return float((abs((power * np.exp(2j * np.pi * waves)).sum()) / power.sum()) ** 2)


def test_what_stands_still_is_left_alone_and_what_races_is_refused(scene):
    still = Simulation(scene())
    assert not still.effects["motion"].modelled
    assert lost_variance(still.geometry, still.plan.samples) == 0.0
    fast = scene(moving(1.0, 0.0))
    with pytest.raises(InputError, match="grains in an exposure"):
        steps(fast, Simulation(fast, Settings(effects=(("motion", False),))).plan.samples)
