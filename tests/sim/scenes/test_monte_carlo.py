"""The Monte Carlo throughput against the closed form, a known limit, and Mitsuba's own path tracer."""

import subprocess
import sys

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")

import sim  # noqa: E402, F401
from correlograph.errors import InputError  # noqa: E402
from radiometry.light_budget_rows import closed_form  # noqa: E402
from scenes import scene_path  # noqa: E402
from sim.scene_file import load_scene  # noqa: E402
from sim.scene_reader import read_geometry  # noqa: E402
from sim.transport.monte_carlo import estimate_throughput  # noqa: E402


@pytest.fixture(scope="module")
def lab():
    scene, _ = load_scene(scene_path("corner_letter"))
    return scene, closed_form(read_geometry(scene).light_path)


def test_it_agrees_with_the_closed_form_to_better_than_a_percent(lab):
    scene, budget = lab
    estimate = estimate_throughput(scene)
    expected = budget.per_pixel * budget.pixels
    low, high = estimate.interval
    assert low < expected < high
    assert (high - low) / 2 < 0.01 * expected


@pytest.mark.slow
def test_the_interval_covers_95_of_100_seeds(lab):
    scene, _ = lab
    reference = estimate_throughput(scene, samples=2**22, seed=10**6).per_frame
    hits = 0
    for seed in range(100):
        low, high = estimate_throughput(scene, samples=2**14, seed=seed).interval
        hits += low <= reference <= high
    assert 89 <= hits <= 99  # 95 +- 2.2, three sigma below, and a sure miss is a defect too


def test_the_integrator_renders_the_budget_in_db(lab):
    scene, budget = lab
    image = mi.render(scene, integrator=mi.load_dict({"type": "throughput", "samples": 2**18}), seed=3)
    assert float(np.array(image).squeeze()) == pytest.approx(budget.per_frame_db, abs=0.05)


def test_seeds_decide(lab):
    scene, _ = lab
    first, again, other = (estimate_throughput(scene, samples=1000, seed=seed).per_frame for seed in (1, 1, 2))
    assert first == again != other
    with pytest.raises(InputError, match="samples"):
        estimate_throughput(scene, samples=1)


ENLARGED = """<scene version="3.0.0">
  <integrator type="{integrator}"/>
  <shape type="rectangle" id="virtual_source"><transform name="to_world">
      <scale value="{source}"/><lookat origin="0.5,0,1" target="0,0,0" up="0,1,0"/></transform>{source_bsdf}</shape>
  <shape type="rectangle" id="hidden_object"><transform name="to_world"><scale x="0.5" y="0.3"/>
      <rotate y="1" angle="20"/></transform>
      <bsdf type="diffuse"><spectrum name="reflectance" value="0.7"/></bsdf></shape>
  <shape type="rectangle" id="hidden_object_step"><transform name="to_world"><scale x="0.2" y="0.2"/>
      <translate x="-0.2" z="0.25"/></transform>
      <bsdf type="diffuse"><spectrum name="reflectance" value="0.4"/></bsdf></shape>
  <shape type="rectangle" id="virtual_detector"><transform name="to_world">
      <scale x="0.6" y="0.5"/><rotate y="1" angle="180"/><translate x="-0.6" z="1.5"/></transform>
      <bsdf type="diffuse"><spectrum name="reflectance" value="0.8"/></bsdf>{camera}</shape>
  <shape type="rectangle" id="plate"><transform name="to_world"><scale value="0.15"/>
      <translate x="-0.35" y="0.1" z="0.9"/></transform>
      <bsdf type="diffuse"><spectrum name="reflectance" value="0"/></bsdf></shape>
  <shape type="rectangle" id="screen"><transform name="to_world"><scale x="0.525" y="1"/><rotate y="1" angle="90"/>
      <translate x="-1.3" z="0.025"/></transform><bsdf type="diffuse"><spectrum name="reflectance" value="0"/></bsdf></shape>
  {rest}
</scene>"""

# The camera looks at the wall at 42 degrees: 888 columns of 1 mm cover its 1.2 m.
CAMERA = """<sensor type="speckle_camera"><float name="pixel_pitch" value="0.001"/><float name="magnification" value="1"/>
  <float name="pupil_diameter" value="0.4"/><float name="exposure" value="1"/>
  <transform name="to_world"><lookat origin="-1.6,0,0.4" target="-0.6,0,1.5" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="888"/><integer name="height" value="1000"/>
  <string name="pixel_format" value="luminance"/></film></sensor>"""

LASER = """<emitter type="laser"><float name="wavelength" value="5e-7"/><float name="power" value="1"/>
  <float name="spot_diameter" value="0.02"/>
  <transform name="to_world"><lookat origin="-0.4,0.6,0.1" target="0.5,0,1" up="0,1,0"/></transform></emitter>"""

PATCH = """<emitter type="area"><spectrum name="radiance" value="{radiance}"/></emitter>"""

METER = """<shape type="disk" id="pupil"><transform name="to_world"><scale value="0.2"/>
  <lookat origin="-1.6,0,0.4" target="-0.6,0,1.5" up="0,1,0"/></transform>
  <bsdf type="diffuse"><spectrum name="reflectance" value="0"/></bsdf>
  <sensor type="irradiancemeter"><film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="64"/>
  <string name="pixel_format" value="luminance"/><string name="component_format" value="float32"/><rfilter type="box"/></film>
  <sampler type="independent"/></sensor></shape>"""


@pytest.mark.slow
def test_mitsubas_path_tracer_agrees_on_an_enlarged_scene():
    """The lit spot becomes a small area light that emits the same power as the Lambertian wall would;
    paths of exactly two reflections that reach the pupil are the difference of two maximum depths."""
    rough = (
        '<bsdf type="phase_screen"><float name="height_rms" value="1e-6"/><float name="correlation_length" value="1e-5"/>'
        '<bsdf type="diffuse"><spectrum name="reflectance" value="1"/></bsdf></bsdf>'
    )
    ours = mi.load_string(
        ENLARGED.format(integrator="speckle", source=0.1, source_bsdf=rough, camera=CAMERA, rest=LASER), optimize=False
    )
    estimate = estimate_throughput(ours, samples=2**21)

    by_two, error = two_reflections()
    assert error < 0.02 * by_two
    assert abs(estimate.per_frame - by_two) < 3.0 * np.hypot(error, estimate.standard_error)


def two_reflections() -> tuple[float, float]:
    """Mitsuba's answer, in a process of its own: a scalar variant, and none of the project's plugins."""
    half = 0.005
    patch = PATCH.format(radiance=1.0 / (np.pi * (2 * half) ** 2))  # one watt in all
    black = '<bsdf type="diffuse"><spectrum name="reflectance" value="0"/></bsdf>'
    scene = ENLARGED.format(integrator="path", source=half, source_bsdf=black + patch, camera="", rest=METER)
    code = """
import sys, mitsuba as mi, numpy as np
mi.set_variant("scalar_rgb")
scene = mi.load_string(sys.stdin.read())
flux = {}
for depth in (2, 3):
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 100, "hide_emitters": True})
    image = np.array(mi.render(scene, integrator=integrator, spp=2048, seed=depth))
    flux[depth] = image.reshape(image.shape[0], image.shape[1], -1)[..., 0] * np.pi * 0.2**2
print(flux[3].mean() - flux[2].mean(), np.sqrt(sum(f.var() / f.size for f in flux.values())))
"""
    run = subprocess.run([sys.executable, "-c", code], input=scene, capture_output=True, text=True, check=True)
    by_two, error = map(float, run.stdout.split())
    return by_two, error
