"""Stray light beats with the object within the coherence length and adds in intensity beyond it: against a sum that shares no code."""

from __future__ import annotations

import re

import numpy as np
import pytest

from radiometry.coherence import coherence, reach_m
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
from sim.backend.variant import llvm_major
from sim.frame import Simulation
from sim.optics.other_light import visibility_by_shape
from sim.plan import Plan, Settings
from sim.plan_report import make_plan

pytestmark = pytest.mark.skipif((llvm_major() or 99) < 17, reason="spheres need libLLVM 17")

LIGHT = 299792458.0
SPOT = np.array([0.1039558, 0.0, 0.4890738])
QUIET = tuple((name, False) for name in ("shot_noise", "detector_roughness", "pupil_and_pixel", "source_grain"))
PIXEL_M = 6.9e-6
FRAME = (400, 370)

PARTS = {
    "hidden_object": ((0.0, 0.0, 0.0), (3e-3, 5e-3), 1.0),
    "left_plate": ((8e-3, 2e-3, 1e-3), (2e-3, 2.4e-3), 0.6),
    "right_plate": ((-6e-3, -4e-3, -4e-3), (1.5e-3, 3e-3), 0.9),
}
"""Centre, width and height in metres, albedo of plates that face the wall."""

BALL = ((4e-3, -9e-3, 2e-3), 1.2e-3, 0.8)
"""Centre, radius, albedo of a sphere."""


def lab(scene, linewidth_hz: float = 0.0, names=("left_plate", "right_plate", "ball")):
    """The reference scene with two plates and a sphere beside a rectangle; `names` renames them."""
    (x, y, z), radius, albedo = BALL
    shapes = ""
    for name, part in zip(names, ("left_plate", "right_plate"), strict=False):
        (px, py, pz), (width, height), reflectance = PARTS[part]
        shapes += (
            f'<shape type="rectangle" id="{name}"><transform name="to_world"><scale x="{width / 2}" y="{height / 2}"/>'
            f'<translate x="{px}" y="{py}" z="{pz}"/></transform><bsdf type="diffuse"><spectrum name="reflectance" '
            f'value="{reflectance}"/></bsdf></shape>'
        )
    shapes += (
        f'<shape type="sphere" id="{names[2]}"><point name="center" x="{x}" y="{y}" z="{z}"/><float name="radius" value="{radius}"/>'
        f'<bsdf type="diffuse"><spectrum name="reflectance" value="{albedo}"/></bsdf></shape>'
    )
    texture = (
        '<texture type="bitmap" name="reflectance">\n                    <string name="filename" value="$albedo"/>\n'
        '                    <boolean name="raw" value="true"/>\n                    <string name="filter_type" value="nearest"/>\n'
        '                    <string name="wrap_mode" value="clamp"/>\n                </texture>'
    )
    width, height = PARTS["hidden_object"][1]
    line = f'<float name="linewidth" value="{linewidth_hz}"/>' if linewidth_hz else ""
    return scene(
        (texture, '<spectrum name="reflectance" value="1"/>'),
        ('<scale x="0.005" y="0.005"/>\n            <rotate z="1" angle="180"/>', f'<scale x="{width / 2}" y="{height / 2}"/>'),
        ('value="616"', f'value="{FRAME[1]}"'),
        ('value="514"', f'value="{FRAME[0]}"'),
        ("</scene>", shapes + "</scene>"),
        ('<float name="power" value="$power"/>', f'<float name="power" value="$power"/>{line}'),
    )


def points(rng: np.random.Generator, count: int = 1500):
    """Return random points of all surfaces, their light on the frame centre, length of their path, and whether they are the object's.

    Two Lambertian reflections: cos cos / d^2 at either end of both segments; walls and object face each other along z.
    """
    places, normals, areas, owner = [], [], [], []
    for name, ((x, y, z), (width, height), albedo) in PARTS.items():
        spread = rng.random((count, 2)) - 0.5
        places.append(np.column_stack([x + width * spread[:, 0], y + height * spread[:, 1], np.full(count, z)]))
        normals.append(np.tile([0.0, 0.0, 1.0], (count, 1)))
        areas.append(np.full(count, albedo * width * height / count))
        owner.append(np.full(count, name == "hidden_object"))
    centre, radius, albedo = BALL
    way = rng.standard_normal((4 * count, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    places.append(np.array(centre) + radius * way)
    normals.append(way)
    areas.append(np.full(4 * count, albedo * 4.0 * np.pi * radius**2 / (4 * count)))
    owner.append(np.zeros(4 * count, bool))
    place, normal, area, mine = (np.concatenate(parts) for parts in (places, normals, areas, owner))
    to_spot, to_wall = SPOT - place, np.array([0.0, 0.0, 1.0]) - place
    near, far = (np.linalg.norm(way, axis=1) for way in (to_spot, to_wall))
    cosines = [
        (to_spot * normal).sum(1) / near,
        (to_wall * normal).sum(1) / far,
        (to_spot @ (SPOT / np.linalg.norm(SPOT))) / near,
        to_wall[:, 2] / far,
    ]
    power = area * np.prod(np.clip(cosines, 0.0, None), axis=0) / (near * far) ** 2
    return place, power, near + far, mine


def expected_covariance(linewidth_hz: float, reach: int, seed: int = 1):
    """Return light over the object's, and the covariance of the intensity over the object's mean squared at displacements of up to
    `reach` pixels (2 reach + 1, 2 reach + 1).

    The mutual intensity of two pixels is the sum over points of power times exp(i k (r - r')), and for two spectral lines also of
    exp(2 pi i (nu - nu') L / c); the covariance is the mean of its square over all pairs of lines.
    """
    place, power, path, mine = points(np.random.default_rng(seed))
    power = power / power[mine].sum()
    steps = np.arange(-reach, reach + 1) * PIXEL_M
    # Columns run along -x, on a wall that the camera sees at 12 degrees; rows run along -y.
    across, down = steps / np.cos(np.deg2rad(12.0)), steps
    wall = np.stack([*np.broadcast_arrays(-across[None, :], -down[:, None], 1.0)], -1).reshape(-1, 3)
    centre = np.linalg.norm(np.array([0.0, 0.0, 1.0]) - place, axis=1)
    phase = np.exp(2j * np.pi / 532e-9 * (np.linalg.norm(wall[:, None] - place[None], axis=2) - centre))
    deviation = 2.0**0.5 * linewidth_hz / (2.0 * (2.0 * np.log(2.0)) ** 0.5)
    offsets = np.linspace(-3.5, 3.5, 71) * deviation if linewidth_hz else np.zeros(1)
    weight = np.exp(-0.5 * np.linspace(-3.5, 3.5, len(offsets)) ** 2) if linewidth_hz else np.ones(1)
    delayed = power[:, None] * np.exp(2j * np.pi * (path - path[mine].mean())[:, None] * offsets / LIGHT)
    covariance = (np.abs(phase @ delayed) ** 2) @ (weight / weight.sum())
    return float(power.sum()), covariance.reshape(len(steps), len(steps))


def rendered_covariance(geometry, frames: int, reach: int):
    """Return mean and covariance of the same, from rendered frames."""
    simulation = Simulation(geometry, Settings(effects=QUIET))
    unit, total, mean = simulation.mean_photoelectrons, 0.0, 0.0
    rows, columns = geometry.camera.frame_shape
    count = np.outer(*(side - np.abs(np.arange(-reach, reach + 1)) for side in (rows, columns)))
    for number in range(frames):
        frame = simulation.expected_frame(5, number).numpy().astype(np.float64) / unit
        mean += frame.mean() / frames
        power = np.abs(np.fft.rfft2(frame - frame.mean(), s=(2 * rows, 2 * columns))) ** 2
        lags = np.fft.fftshift(np.fft.irfft2(power, s=(2 * rows, 2 * columns)))
        total = total + lags[rows - reach : rows + reach + 1, columns - reach : columns + reach + 1] / count / frames
    return mean, total


@pytest.mark.slow
@pytest.mark.parametrize(("linewidth_hz", "tolerance"), [(0.0, 0.08), (3e10, 0.08), (4e11, 0.16)])
def test_two_plates_and_a_sphere_are_those_of_a_direct_sum(scene, linewidth_hz, tolerance):
    """Mean, contrast and covariance for coherent, half coherent and incoherent stray light, whose own loss of contrast is approximate."""
    geometry = lab(scene, linewidth_hz)
    light, expected = expected_covariance(linewidth_hz, 14)
    mean, found = rendered_covariance(geometry, 10, 14)
    assert 1.0 + geometry.other_light_share == pytest.approx(light, rel=0.03)
    assert mean == pytest.approx(light, rel=0.03)
    middle = (14, 14)
    assert found[middle] == pytest.approx(expected[middle], rel=0.06)
    assert np.linalg.norm(found - expected) < tolerance * np.linalg.norm(expected)


def test_the_sum_tells_the_three_cases_apart():
    """A test of the test: the covariances differ by more than its tolerance."""
    cases = [expected_covariance(linewidth_hz, 14)[1] for linewidth_hz in (0.0, 3e10, 4e11)]
    for one, other in ((0, 1), (1, 2)):
        assert np.linalg.norm(cases[one] - cases[other]) > 0.2 * np.linalg.norm(cases[other])


@pytest.mark.slow
def test_coherent_stray_light_looks_like_a_second_object(scene):
    """The autocorrelation is that of a scene in which the same shapes are hidden objects, with beats at the same lags."""
    seen = []
    for names in (("a", "b", "c"), ("hidden_object_2", "hidden_object_3", "hidden_object_4")):
        geometry = lab(scene, names=names)
        simulation = Simulation(geometry, Settings(effects=QUIET))
        frames = [simulation.expected_frame(2, number).numpy() for number in range(16)]
        estimate, _ = estimate_autocorrelation(frames, simulation.plan.prediction.grid)
        seen.append(estimate / np.mean([frame.mean() for frame in frames]) ** 2)
    # The object's centre differs, and with it the pitch, by less than a percent; Gamma noise of the estimates remains.
    first, second = (image / np.linalg.norm(image) for image in seen)
    assert float((first * second).sum()) > 0.97


@pytest.mark.slow
def test_beats_fall_with_linewidth_and_path_difference_as_gamma_squared(scene):
    """Visibility gamma^2 = exp(-2 (pi dnu tau)^2 / (4 ln 2)) of a plate 4 mm in front of the object."""
    geometry = lab(scene, 2e10)
    samples = Plan.of(geometry).samples
    seen = visibility_by_shape(geometry, samples)
    place = np.array(PARTS["right_plate"][0])
    path = np.linalg.norm(SPOT - place) + np.linalg.norm(np.array([0.0, 0.0, 1.0]) - place) - np.linalg.norm(SPOT) - 1.0
    assert seen["right_plate"] == pytest.approx(coherence(np.array([path / LIGHT]), 2e10)[0] ** 2, rel=0.1)
    assert coherence(np.array([reach_m(2e10) / LIGHT]), 2e10)[0] == pytest.approx(1e-2)
    assert reach_m(0.0) == np.inf


@pytest.mark.slow
def test_the_plan_names_what_beats_and_what_does_not(scene):
    for linewidth_hz, word in ((0.0, "beat"), (1e13, "intensity")):
        plan = make_plan(lab(scene, linewidth_hz), 2)
        paths = {path["name"]: path for path in plan["light_paths"]}
        assert set(paths) >= {"hidden_object", "left_plate", "right_plate", "ball", "direct_light", "lamps"}
        assert word in paths["left_plate"]["effect"]
        assert paths["hidden_object"]["share"] == 1.0
        assert sum(path["share"] for name, path in paths.items() if name in PARTS or name == "ball") > 1.5
        effect = next(effect for effect in plan["effects"] if effect["name"] == "other_light")
        assert re.search(r"[\d.]+ beats with it, [\d.e-]+ adds in intensity", effect["why"])
