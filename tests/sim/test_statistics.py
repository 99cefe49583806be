"""Speckle statistics of rendered frames against closed forms."""

import numpy as np
import pytest
import torch

pytest.importorskip("mitsuba")

from radiometry.sensor.chain import expose
from radiometry.sensor.electronics import Electronics
from sim.laser_speckle import grain_m
from sim.optics.illumination import illuminate
from sim.optics.object_samples import sample_object
from sim.propagation.fraunhofer import far_field


def test_fraunhofer_matches_the_sum(rng):
    field = rng.standard_normal((5, 7)) + 1j * rng.standard_normal((5, 7))
    wall = far_field(torch.from_numpy(field), (12, 16)).numpy()
    row, column = 3, 11
    wave = np.exp(-2j * np.pi * (row * np.arange(5)[:, None] / 12 + column * np.arange(7)[None, :] / 16))
    assert wall[row, column] == pytest.approx((field * wave).sum())
    assert (np.abs(wall) ** 2).mean() == pytest.approx((np.abs(field) ** 2).sum())


def wall_intensity(simulation, number: int) -> np.ndarray:
    """Intensity before pupil and pixel, mean 1 over realisations."""
    samples = sample_object(simulation.geometry)
    shape = simulation.geometry.camera.frame_shape
    lit = samples.lit(illuminate(simulation.geometry, samples.grid, np.random.default_rng, number), shape)
    field = lit.lattice.grid(lit.amplitude)
    wall = far_field(torch.from_numpy(field), shape)
    return (wall.abs() ** 2).numpy() / samples.brightness


def test_speckle_is_fully_developed(letter_simulation):
    simulation = letter_simulation("R")
    images = [wall_intensity(simulation, number) for number in range(4)]
    contrast = np.mean([image.std() / image.mean() for image in images])
    assert contrast == pytest.approx(1.0, abs=0.02)
    # negative exponential: P(I > t <I>) = exp(-t); about 7e4 grains in four frames
    for threshold in (0.2, 1.0, 3.0):
        tail = np.mean([(image > threshold * image.mean()).mean() for image in images])
        assert tail == pytest.approx(np.exp(-threshold), rel=0.05)


@pytest.mark.slow
def test_grain_on_the_virtual_detector(letter_simulation):
    """Width of the intensity covariance: integral of |mu|^2 is (lambda z)^2 int r^2 / (int r)^2."""
    simulation = letter_simulation("L")
    geometry = simulation.geometry
    areas = []
    for number in range(6):
        image = wall_intensity(simulation, number)
        spectrum = np.abs(np.fft.fft2(image - 1.0)) ** 2
        areas.append(np.mean([spectrum[r, c] for r, c in ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2), (2, 1), (1, 2))]))
    albedo = sample_object(geometry).amplitude.astype(np.float64) ** 2
    cell = np.prod(geometry.object_pitch_m)
    expected = (geometry.wavelength_m * geometry.distance_m) ** 2 * (albedo**2).sum() / albedo.sum() ** 2 / cell
    measured = np.mean(areas) / image.size * geometry.camera.pixel_pitch_m**2
    # 48 exponential draws, and lags of 31 um inside a grain of 53 um on the object raise r*r by up to 2
    assert 0.6 * expected < measured < 2.4 * expected


def test_the_object_is_lit_by_grains_of_lambda_d_over_spot(letter_simulation):
    geometry = letter_simulation("F").geometry
    assert grain_m(geometry) == pytest.approx(532e-9 * 0.5 / 5e-3, rel=1e-3)
    covariance = 0.0
    for number in range(40):
        field = illuminate(geometry, (256, 128), np.random.default_rng, number)
        assert np.mean(np.abs(field) ** 2) == pytest.approx(1.0, abs=0.15)
        intensity = np.abs(field) ** 2 - 1.0
        covariance = covariance + np.abs(np.fft.fft2(intensity)) ** 2
    correlation = np.fft.ifft2(covariance).real
    correlation /= correlation[0, 0]
    # a uniform disc: |2 J1(v) / v|^2 with v = pi D x / (lambda d1), down to 0.5 at v = 1.616 (Goodman)
    pitch = geometry.object_pitch_m[1]
    half_width = 1.616 / np.pi * grain_m(geometry)
    assert np.interp(half_width, pitch * np.arange(6), correlation[0, :6]) == pytest.approx(0.5, abs=0.08)


def test_energy_agrees_with_the_closed_form(letter_simulation):
    simulation = letter_simulation("7", exposure="1")
    frames = [float(simulation.expected_frame(5, number).mean()) for number in range(4)]
    assert np.mean(frames) == pytest.approx(simulation.mean_photoelectrons, rel=0.02)
    assert simulation.mean_photoelectrons * 2056 * 2464 == pytest.approx(simulation.budget.photoelectrons_per_frame_s)


def test_frames_of_a_capture_are_independent_and_reproducible(letter_simulation):
    simulation = letter_simulation("F", exposure="1")
    first, second = simulation.expected_frame(3, 0).numpy(), simulation.expected_frame(3, 1).numpy()
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.02
    assert np.array_equal(simulation.frame(3, 1).numpy(), simulation.frame(3, 1).numpy())
    assert not np.array_equal(simulation.frame(3, 0).numpy(), simulation.frame(4, 0).numpy())


def test_a_black_object_gives_empty_frames(letter_simulation, tmp_path):
    from PIL import Image

    Image.fromarray(np.zeros((16, 16), np.uint8)).save(tmp_path / "black.png")
    from scenes import scene_path
    from sim.frame import Simulation
    from sim.scene_file import load_scene
    from sim.scene_reader import read_geometry

    scene, _ = load_scene(scene_path("corner_letter"), {"albedo": str(tmp_path / "black.png")})
    assert not Simulation(read_geometry(scene)).frame(0, 0).numpy().any()


def test_electronics(rng):
    mean = np.full((400, 300), 20.0, np.float32)
    quiet = expose(mean, Electronics(0.5), rng)
    assert quiet.var() == pytest.approx(20.0, rel=0.03)
    noisy = expose(mean, Electronics(0.5, read_noise=3.0, dark_current=10.0), rng)
    assert noisy.mean() == pytest.approx(25.0, rel=0.01)
    assert noisy.var() == pytest.approx(25.0 + 9.0, rel=0.03)
    rows = expose(mean, Electronics(0.5, row_noise=4.0), rng).mean(1)
    assert rows.var() == pytest.approx(16.0 + 20.0 / 300, rel=0.25)
    clipped = expose(mean, Electronics(0.5, full_well=24.0, bits=4), rng)
    assert clipped.max() == pytest.approx(24.0)
    np.testing.assert_allclose(clipped / 1.6, np.round(clipped / 1.6), atol=1e-5)
