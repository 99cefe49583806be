"""Effects against closed forms and brute-force sums of modes."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.constants import speed_of_light

pytest.importorskip("mitsuba")

from correlograph.errors import InputError
from radiometry.coherence import autocorrelate_coherent, coherence, spectral_lines, variance_lost_to_linewidth
from radiometry.sensor.chain import expose
from radiometry.sensor.electronics import Electronics
from scenes import scene_path
from sim.effects import parse_effects
from sim.frame import Simulation
from sim.optics.illumination import lost_over_spot, overlap, specular_field, specular_share
from sim.plan import Settings
from sim.plan_report import make_plan
from sim.propagation import nufft
from sim.propagation.kernels import KERNELS


def contrast(simulation: Simulation, frames: int = 6) -> float:
    images = [simulation.expected_frame(11, number) for number in range(frames)]
    return float(np.mean([float(image.std() / image.mean()) for image in images]))


BARE = (("pupil_and_pixel", False),)


@pytest.mark.slow
def test_contrast_is_one_and_one_over_root_two_when_depolarised(scene, depolarising):
    assert contrast(Simulation(scene(), Settings(effects=BARE))) == pytest.approx(1.0, abs=0.03)
    geometry = scene(depolarising)
    assert contrast(Simulation(geometry, Settings(effects=BARE))) == pytest.approx(1.0 / np.sqrt(2.0), abs=0.02)
    off = Simulation(geometry, Settings(effects=(*BARE, ("depolarisation", False))))
    assert contrast(off) == pytest.approx(1.0, abs=0.03)


def test_path_differences_across_the_spot_are_warned_of(scene):
    """The loss of contrast of 100 GHz against pairs of random points of the spot; a line of 1 GHz is narrow enough."""
    wide, narrow = (scene(("</emitter>", f'<float name="linewidth" value="{hz:g}"/></emitter>')) for hz in (1e11, 1e9))
    spot, rng = wide.spot, np.random.default_rng(2)
    side = np.cross(spot.normal, [0.3, 1.0, 0.2])
    side /= np.linalg.norm(side)
    radius, angle = 0.5 * spot.diameter_m * np.sqrt(rng.random(4000)), 2.0 * np.pi * rng.random(4000)
    up = np.cross(spot.normal, side)
    points = spot.centre + radius[:, None] * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up)
    way = points @ spot.beam + np.linalg.norm(wide.hidden_object.centre - points, axis=1)
    expected = 1.0 - np.mean(coherence((way[:2000] - way[2000:]) / speed_of_light, 1e11) ** 2)
    spread_m, lost = lost_over_spot(wide)
    assert np.ptp(way) == pytest.approx(spread_m, rel=0.03)
    assert lost == pytest.approx(expected, abs=0.02)
    assert lost > 0.1
    assert any("across the laser spot" in warning for warning in make_plan(wide, 1)["warnings"])
    assert not any("across the laser spot" in warning for warning in make_plan(narrow, 1)["warnings"])


def test_sum_of_lines_has_the_coherence_of_the_spectrum():
    """Beat of two scatterers a delay apart, summed over lines, against the Gaussian's closed form."""
    spread_m, linewidth_hz = 0.02, 9e9
    lines = spectral_lines(np.array([0.0, spread_m]), linewidth_hz)
    assert sum(weight for _, weight in lines) == pytest.approx(1.0)
    for path in np.linspace(0.0, spread_m, 7):
        beat = sum(weight * np.exp(2j * np.pi * offset * path / speed_of_light) for offset, weight in lines)
        assert abs(beat - coherence(path / speed_of_light, linewidth_hz)) < 5e-3
    half = 2.0 * np.log(2.0) / (np.pi * linewidth_hz)  # of a Gaussian line: gamma falls to 1/2 here
    assert coherence(half, linewidth_hz) == pytest.approx(0.5)


@pytest.mark.slow
def test_linewidth_lowers_contrast_as_the_paths_say(scene):
    """A plate tilted by 60 degrees under a broad laser: measured contrast against the sum over pairs of scatterers."""
    tilted = ('<rotate z="1" angle="180"/>', '<rotate z="1" angle="180"/><rotate y="1" angle="60"/>')
    spot = 'name="spot_diameter" value="5e-3"'
    geometry = scene(tilted, (spot, f'{spot}/><float name="linewidth" value="2e10"'))
    settings = Settings(effects=(*BARE, ("source_grain", False)), tolerance=0.05)
    simulation = Simulation(geometry, settings)
    samples = simulation._samples
    power = samples.amplitude.astype(np.float64) ** 2 / samples.brightness
    chosen = np.random.default_rng(0).choice(len(power), (2, 200_000), p=power / power.sum())
    delay = (samples.path_m[chosen[0]] - samples.path_m[chosen[1]]) / speed_of_light
    predicted = float((coherence(delay, 2e10) ** 2).mean())
    assert 0.2 < predicted < 0.9
    assert 1.0 - variance_lost_to_linewidth(samples.path_m, samples.amplitude, 2e10) == pytest.approx(predicted, rel=0.01)
    assert simulation.effects["linewidth"].modelled
    assert contrast(simulation) ** 2 == pytest.approx(predicted, rel=0.08)
    narrow = Simulation(scene(tilted), settings)
    assert not narrow.effects["linewidth"].modelled
    assert contrast(narrow) == pytest.approx(1.0, abs=0.03)


def test_too_broad_a_laser_is_refused():
    with pytest.raises(InputError, match="at most"):
        spectral_lines(np.array([0.0, 1.0]), 1e14)


def test_source_grain_can_be_left_out(scene):
    grainy = Simulation(scene(), Settings(effects=BARE))
    even = Simulation(scene(), Settings(effects=(*BARE, ("source_grain", False))))
    assert not np.allclose(grainy.expected_frame(1, 0), even.expected_frame(1, 0))
    assert contrast(even) == pytest.approx(1.0, abs=0.03)


def test_electronics_one_by_one(rng):
    flat = np.full((400, 300), 50.0)
    columns = expose(flat, Electronics(1.0, column_noise=7.0, shot_noise=False), rng)
    assert (columns == columns[:1]).all()
    assert columns[0].std() == pytest.approx(7.0, rel=0.15)
    patterned = Electronics(1.0, fixed_pattern=4.0, shot_noise=False)
    first, second = (expose(flat, patterned, np.random.default_rng(n)) for n in (1, 2))
    np.testing.assert_array_equal(first, second)
    assert first.std() == pytest.approx(4.0, rel=0.02)
    ramp = np.linspace(0.0, 400.0, 300)[None].repeat(2, 0)
    gained = expose(ramp, Electronics(1.0, bits=6, gain=5.0, shot_noise=False), rng)
    assert set(np.unique(gained)) == {5.0 * number for number in range(64)}
    shot = expose(flat, Electronics(1.0), rng)
    assert shot.var() == pytest.approx(50.0, rel=0.02)
    with pytest.raises(InputError, match="bits"):
        Electronics(1.0, bits=8)
    with pytest.raises(InputError, match="gain"):
        Electronics(1.0, gain=2.0)


@pytest.mark.slow
def test_effects_forced_off_and_on(scene):
    exposure = '<float name="exposure" value="$exposure"/>'
    noisy = scene((exposure, f'{exposure}<float name="read_noise" value="30"/>'))
    quiet = Simulation(noisy, Settings(effects=(("read_noise", False), ("shot_noise", False))))
    torch.testing.assert_close(quiet.frame(0, 0), quiet.expected_frame(0, 0))
    assert float((Simulation(noisy).frame(0, 0) - quiet.expected_frame(0, 0)).std()) == pytest.approx(30.0, rel=0.05)
    with pytest.raises(InputError, match="read_noise"):
        Simulation(scene(), Settings(effects=(("read_noise", True),)))
    for text in ("read_noise", "gravity=on", "read_noise=maybe"):
        with pytest.raises(InputError, match="--effect"):
            parse_effects([text])
    with pytest.raises(InputError, match="once"):
        parse_effects(["linewidth=on", "linewidth=off"])
    assert parse_effects(["linewidth=on", "read_noise=auto"]) == (("linewidth", True),)


def test_ambient_light_has_its_closed_form(scene):
    """A point source before the wall: I cos / d^2, and its photoelectrons on top of the speckle, shot noise included."""
    lamp = (
        '<emitter type="point"><point name="position" x="0.02" y="0.01" z="0.8"/>'
        '<spectrum name="intensity" value="4e-9"/></emitter>'
    )
    geometry = scene(("</scene>", f"{lamp}</scene>"))
    way = np.array([0.02, 0.01, -0.2])
    expected = 4e-9 * 0.2 / np.linalg.norm(way) ** 3
    assert geometry.wall.ambient_irradiance.mean() == pytest.approx(expected, rel=0.02)
    bright, dark = Simulation(geometry), Simulation(geometry, Settings(effects=(("ambient", False),)))
    gained = float((bright.expected_frame(0, 0) - dark.expected_frame(0, 0)).mean())
    path = geometry.light_path
    photons = expected * path.pixel_area_m2 * path.wavelength_m / (6.62607015e-34 * 299792458.0) * 0.125
    pupil = np.sin(np.arctan(0.5 * path.pupil_diameter_m / path.detector_to_pupil_m)) ** 2
    assert gained == pytest.approx(photons * pupil * path.detector_cosine_out, rel=0.03)
    plan = make_plan(geometry, 2)
    assert next(effect for effect in plan["effects"] if effect["name"] == "ambient")["modelled"]
    with pytest.raises(InputError, match="ambient"):
        Simulation(scene(), Settings(effects=(("ambient", True),)))


@pytest.mark.parametrize("share", [0.0, 0.2, 0.6, 1.0])
def test_spots_that_overlap_correlate_frames(scene, share):
    """Field correlation is the overlap of two discs, intensity correlation its square; none from one diameter on."""
    spot = 'name="spot_diameter" value="5e-3"'
    geometry = scene((spot, f'{spot}/><float name="scan_step" value="{share * 5e-3}"'))
    simulation = Simulation(geometry, Settings(effects=BARE))
    fields = [simulation.wall_field(7, number) for number in range(2)]
    correlation = abs(complex((fields[0] * fields[1].conj()).mean())) / float(fields[0].abs().square().mean())
    common = 2.0 / np.pi * (np.arccos(share) - share * np.sqrt(1.0 - share**2))
    assert overlap(geometry) == pytest.approx(common, abs=1e-12)
    assert correlation == pytest.approx(common, abs=0.06)
    images = [field.abs().square().numpy().ravel() for field in fields]
    assert np.corrcoef(*images)[0, 1] == pytest.approx(common**2, abs=0.06)
    warned = any("scan_step" in warning for warning in make_plan(geometry, 2)["warnings"])
    assert warned == (share < 1.0)


def smooth_source(height_rms_m: float) -> tuple[str, str]:
    """The virtual source alone with other heights: it is the first with a phase_screen."""
    text = scene_path("corner_letter").read_text()
    start = text.index('id="virtual_source"')
    old = text[start : text.index("</bsdf>", start)]
    return old, old.replace('value="2e-6"', f'value="{height_rms_m}"')


@pytest.mark.slow
@pytest.mark.parametrize("height_rms_m", [0.0, 1e-8, 3e-8, 6e-8, 2e-6])
def test_the_specular_share_of_a_smooth_wall(scene, rng, height_rms_m):
    geometry = scene(smooth_source(height_rms_m))
    phase = 4.0 * np.pi * height_rms_m * rng.standard_normal(400_000) / 532e-9
    assert specular_share(geometry) == pytest.approx(abs(np.exp(1j * phase).mean()) ** 2, abs=5e-3)


@pytest.mark.slow
def test_light_that_a_smooth_wall_does_not_scatter_misses_the_object(scene):
    """The specular direction misses the object of the reference scene, which receives the scattered fraction 1 - exp(-g)."""
    rough = Simulation(scene())
    mean = float(np.mean([float(rough.expected_frame(2, n).mean()) for n in range(4)]))
    for height_rms_m in (0.0, 3e-8):
        geometry = scene(smooth_source(height_rms_m))
        smooth = Simulation(geometry)
        scattered = float(np.mean([float(smooth.expected_frame(2, n).mean()) for n in range(4)]))
        assert scattered / mean == pytest.approx(1.0 - specular_share(geometry), abs=0.03)
        assert any("specular" in warning for warning in make_plan(geometry, 2)["warnings"])


def test_the_mirror_image_of_the_spot_is_its_fraunhofer_integral(scene):
    """Irradiance of an evenly lit disc at the object, summed over its surface, against the Lambertian P / (pi d^2)."""
    old = 'origin="0.06, 0.25, 0.1" target="0.1039558, 0, 0.4890738"'
    geometry = scene(smooth_source(0.0), (old, old.replace("0.06, 0.25, 0.1", "0.02079116, 0, 0.09781476")))
    rows, columns = ((np.arange(n) - 0.5 * (n - 1)) * step for n, step in zip((3, 41), geometry.object_pitch_m, strict=True))
    field = specular_field(geometry, rows[:, None], columns[None])
    across = (np.arange(400) - 199.5) * 5e-3 / 400
    disc = np.hypot(across[:, None], across[None]) <= 2.5e-3
    distance = geometry.source_distance_m
    for column in (20, 22, 30):
        offset = (column - 20) * geometry.object_pitch_m[1] * np.cos(np.deg2rad(12.0))  # as the source sees it
        wave = np.exp(-2j * np.pi * across * offset / (532e-9 * distance))
        cell = (5e-3 / 400) ** 2
        irradiance = abs((disc * wave).sum() * cell) ** 2 / (532e-9 * distance) ** 2 / (disc.sum() * cell)
        assert abs(field[1, column]) ** 2 == pytest.approx(irradiance * np.pi * distance**2, rel=0.05, abs=1e3)


@pytest.mark.slow
def test_a_converter_with_gain_works_with_every_setting(scene):
    exposure = '<float name="exposure" value="$exposure"/>'
    geometry = scene((exposure, f'{exposure}<integer name="bits" value="8"/><float name="gain" value="2"/>'))
    frame = Simulation(geometry).frame(0, 0)
    assert not (frame % 2.0).any()
    free = Simulation(geometry, Settings(effects=(("quantisation", False),))).frame(0, 0)
    assert (free % 2.0).any()


@pytest.mark.slow
def test_depolarised_and_ambient_light_are_in_the_prediction(scene, depolarising):
    from radiometry.prediction import predict

    plain = predict(scene()).terms.over_peak()
    depolarised = predict(scene(depolarising)).terms.over_peak()
    assert depolarised["signal"] == pytest.approx(2.0 * plain["signal"])


@pytest.mark.slow
def test_plans_are_strict_json_where_a_kernel_cannot_be_had(scene, monkeypatch):
    deep = ('<rotate z="1" angle="180"/>', '<rotate z="1" angle="180"/><rotate y="1" angle="75"/>')
    monkeypatch.setattr(nufft, "MAX_TERMS", 5)
    # Consider it, however quick the direct sum is.
    monkeypatch.setitem(KERNELS, "nufft", replace(KERNELS["nufft"], planning_seconds=0.0))
    plan = make_plan(scene(deep), 1, Settings("field", 1e-9))
    assert json.dumps(plan, allow_nan=False)
    assert plan["propagator"] == "direct"
    assert any(option["seconds"] is None for option in plan["propagators"])


def test_a_linewidth_lowers_the_predicted_lags_as_every_pair_of_cells_says(rng):
    """Against the sum over all pairs of cells, each lowered by gamma^2 of its own path difference."""
    albedo, path_m, linewidth_hz = rng.random((6, 6)), 1e-3 * rng.random((6, 6)), 2e11
    found = autocorrelate_coherent(albedo, path_m, linewidth_hz)
    expected = np.zeros((11, 11))
    for first in np.ndindex(6, 6):
        for second in np.ndindex(6, 6):
            kept = coherence(np.array((path_m[first] - path_m[second]) / 299792458.0), linewidth_hz) ** 2
            expected[5 + first[0] - second[0], 5 + first[1] - second[1]] += albedo[first] * albedo[second] * kept
    np.testing.assert_allclose(found, expected, atol=1e-4 * expected.max())
    np.testing.assert_allclose(autocorrelate_coherent(albedo, path_m, 0.0), autocorrelate_coherent(albedo, 0.0 * path_m, 1e12))
