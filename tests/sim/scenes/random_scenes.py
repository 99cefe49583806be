"""Scenes drawn at random, once in the project's vocabulary and once as a plain Mitsuba scene with the same light.

Proportions are enlarged (objects and frame a fifth to a half of their distance, wavelength to match), so that an ordinary path
tracer finds the light. In the plain scene the laser's spot is an area light that emits what the Lambertian wall would, and an
irradiance meter lies on the wall; what the camera makes of it is summed here in numpy.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass

import numpy as np

PIXELS = (132, 150)
"""Rows and columns of a frame."""


@dataclass(frozen=True)
class RandomScene:
    """One scene in both dialects.

    Attributes:
        ours, plain: XML.
        shares: photoelectrons of a frame per unit of irradiance on each cell of the meter, (32, 32).
    """

    ours: str
    plain: str
    shares: np.ndarray
    told: str


def random_scene(seed: int) -> RandomScene:
    rng = np.random.default_rng(seed)
    scale = float(np.exp(rng.uniform(np.log(0.2), np.log(20.0))))  # object to wall, in metres
    shapes, told = zip(*(_object(rng, index) for index in range(rng.integers(1, 4))), strict=True)
    if rng.random() < 0.5:
        x, y = rng.uniform(-0.15, 0.15, 2)
        placed = f'<translate x="{x}" y="{y}" z="{rng.uniform(0.28, 0.36)}"/>'
        shapes += (_rectangle("plate", 0.1, 0.06, placed, _diffuse(0)),)
        told += ("an occluder",)
    angle = rng.uniform(-60.0, 60.0)
    about_up = bool(rng.random() < 0.5)
    angle = -abs(angle) if about_up else angle  # away from the virtual source
    wall, camera, shares = _wall(rng, angle, about_up, scale)
    azimuth, distance = np.deg2rad(rng.uniform(15.0, 45.0)), rng.uniform(0.5, 0.9)
    place = distance * np.array([np.sin(azimuth), 0.2 * rng.normal(), np.cos(azimuth)])
    spot = 0.05
    at = f'<lookat origin="{place[0]},{place[1]},{place[2]}" target="0,0,0" up="0,1,0"/>'
    screen = (
        '<bsdf type="phase_screen"><float name="height_rms" value="{0}"/><float name="correlation_length" value="{0}"/>'
        '<bsdf type="diffuse"><spectrum name="reflectance" value="1"/></bsdf></bsdf>'
    ).format(10.0 * scale)
    # The beam falls square on the wall, a little beside the line to the object, which it would cross otherwise.
    laser = (
        f'<emitter type="laser"><float name="wavelength" value="{0.0036 * scale}"/><float name="power" value="1e-12"/>'
        f'<float name="spot_diameter" value="{2 * spot * scale}"/><transform name="to_world">'
        f'<lookat origin="{place[0] * 0.98},{place[1] * 0.98},{place[2] * 0.98}" '
        f'target="{place[0]},{place[1]},{place[2]}" up="0,1,0"/><scale value="{scale}"/></transform></emitter>'
    )
    source = _rectangle("virtual_source", 0.12, 0.12, at, screen)
    lamp = (
        f'<shape type="disk"><transform name="to_world"><scale value="{spot}"/>{at}</transform>{_diffuse(0)}'
        f'<emitter type="area"><spectrum name="radiance" value="{1.0 / (np.pi * np.pi * (spot * scale) ** 2)}"/></emitter>'
        "</shape>"
    )
    ours = _scene("speckle", (*shapes, source, laser, wall.replace("<!-- sensor -->", camera)), scale)
    meter = (
        '<sensor type="irradiancemeter"><film type="hdrfilm"><integer name="width" value="32"/><integer name="height" '
        'value="32"/><string name="pixel_format" value="luminance"/><string name="component_format" value="float32"/>'
        '<rfilter type="box"/></film><sampler type="independent"/></sensor>'
    )
    plain = _scene("path", (*shapes, lamp, wall.replace("<!-- sensor -->", meter)), scale)
    return RandomScene(ours, plain, shares, f"{', '.join(told)}; camera at {angle:.0f} degrees; {scale:.2g} m")


def path_traced(scenes: list[RandomScene], spp: int = 4096) -> list[tuple[float, float]]:
    """Photoelectrons of a frame per laser photon by Mitsuba's own path tracer, and standard errors.

    In a process of its own: a scalar variant and none of the project's plugins. Light of one reflection is the difference of
    two maximum depths.
    """
    code = """
import json, sys, mitsuba as mi, numpy as np
mi.set_variant("scalar_rgb")
spp, scenes = json.load(sys.stdin)
found = []
for number, text in enumerate(scenes):
    scene = mi.load_string(text)
    integrator = mi.load_dict({"type": "volpath", "max_depth": 2, "rr_depth": 100, "hide_emitters": True})
    images = [np.array(mi.render(scene, integrator=integrator, spp=spp // 4, seed=4 * number + part)) for part in range(4)]
    found.append([image.reshape(32, 32, -1)[..., 0].tolist() for image in images])
json.dump(found, sys.stdout)
"""
    run = subprocess.run(
        [sys.executable, "-c", code],
        input=json.dumps([spp, [scene.plain for scene in scenes]]),
        capture_output=True,
        text=True,
        check=True,
    )
    results = []
    for scene, images in zip(scenes, json.loads(run.stdout), strict=True):
        parts = np.array([(np.array(image) * scene.shares).sum() for image in images])
        # Cells are independent: their scatter about the mean of the four tells the error of the sum.
        spread = np.array(images).var(0, ddof=1) * scene.shares**2
        results.append((float(parts.mean()), float(np.sqrt(spread.sum() / 4.0))))
    return results


def _scene(integrator: str, parts: tuple[str, ...], scale: float) -> str:
    text = "\n".join(parts)
    # One factor for all lengths: transforms are given in units of the standoff.
    text = text.replace("</transform>", f'<scale value="{scale}"/></transform>').replace(
        f'<scale value="{scale}"/><scale value="{scale}"/></transform>', f'<scale value="{scale}"/></transform>'
    )
    return f'<scene version="3.0.0"><integrator type="{integrator}"/>{text}</scene>'


def _object(rng: np.random.Generator, index: int) -> tuple[str, str]:
    kind = rng.choice(["rectangle", "sphere", "cube", "disk", "cylinder"])
    x, y = rng.uniform(-0.12, 0.12, 2)
    z = rng.uniform(-0.3, 0.2) if index else 0.0
    size, tilt, turn = rng.uniform(0.04, 0.09), rng.uniform(-70.0, 70.0), rng.uniform(0.0, 360.0)
    bsdf, surface = _bsdf(rng)
    shape = (
        f'<shape type="{kind}" id="hidden_object_{index}"><transform name="to_world"><scale x="{size}" y="{1.3 * size}" '
        f'z="{size}"/><rotate z="1" angle="{turn}"/><rotate x="0.6" y="0.8" angle="{tilt}"/>'
        f'<translate x="{x}" y="{y}" z="{z}"/></transform>{bsdf}</shape>'
    )
    if kind in ("sphere", "cylinder"):
        shape = shape.replace(f'y="{1.3 * size}"', f'y="{size}"')
    return shape, f"{surface} {kind} {z:.2f} deep, tilted by {tilt:.0f}"


def _bsdf(rng: np.random.Generator) -> tuple[str, str]:
    rough, albedo = rng.uniform(0.25, 0.6), rng.uniform(0.3, 1.0)
    checks = (
        f'<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"><spectrum name="color0" value="{albedo}"/>'
        '<spectrum name="color1" value="0.05"/><transform name="to_uv"><scale x="3" y="2"/></transform></texture></bsdf>'
    )
    kinds = {
        "diffuse": _diffuse(albedo),
        "two-sided": f'<bsdf type="twosided">{_diffuse(albedo)}</bsdf>',
        "checkered": checks,
        "masked": f'<bsdf type="mask"><float name="opacity" value="{rng.uniform(0.2, 0.8)}"/>'
        f'<bsdf type="twosided">{_diffuse(albedo)}</bsdf></bsdf>',
        "metal": f'<bsdf type="roughconductor"><float name="alpha" value="{rough}"/></bsdf>',
        "plastic": f'<bsdf type="roughplastic"><float name="alpha" value="{rough}"/>'
        f'<spectrum name="diffuse_reflectance" value="{albedo}"/></bsdf>',
        "principled": f'<bsdf type="principled"><float name="roughness" value="{rough}"/>'
        f'<float name="metallic" value="{rng.uniform(0, 1)}"/>'
        f'<spectrum name="base_color" value="{albedo}"/></bsdf>',
    }
    name = str(rng.choice(list(kinds)))
    return kinds[name], name


def _wall(rng: np.random.Generator, angle: float, about_up: bool, scale: float) -> tuple[str, str, np.ndarray]:
    """The wall, exactly as large as the frame's footprint; its camera; what it makes of each cell's irradiance."""
    pitch, pupil, away = 0.0018, 0.15, rng.uniform(0.35, 0.6)
    height, width = PIXELS[0] * pitch, PIXELS[1] * pitch
    inclination = np.cos(np.deg2rad(angle))
    tall, wide = (height, width / inclination) if about_up else (height / inclination, width)
    centre = np.array([rng.uniform(-0.3, 0.0), rng.uniform(-0.1, 0.1), 1.0])
    sine = np.sin(np.deg2rad(angle))
    back = np.array([sine, 0.0, -inclination]) if about_up else np.array([0.0, sine, -inclination])
    eye = centre + away * back
    wall = _rectangle(
        "virtual_detector",
        0.5 * wide * 1.000001,
        0.5 * tall * 1.000001,
        f'<rotate y="1" angle="180"/><translate x="{centre[0]}" y="{centre[1]}" z="{centre[2]}"/>',
        _diffuse(0.8),
        "<!-- sensor -->",
    )
    efficiency = rng.uniform(0.4, 1.0)
    camera = (
        f'<sensor type="speckle_camera"><float name="pixel_pitch" value="{pitch * scale}"/>'
        f'<float name="magnification" value="1"/><float name="pupil_diameter" value="{pupil * scale}"/>'
        f'<float name="exposure" value="1"/><float name="quantum_efficiency" value="{efficiency}"/>'
        f'<transform name="to_world"><lookat origin="{eye[0]},{eye[1]},{eye[2]}" '
        f'target="{centre[0]},{centre[1]},{centre[2]}" up="0,1,0"/></transform><film type="hdrfilm">'
        f'<integer name="width" value="{PIXELS[1]}"/><integer name="height" value="{PIXELS[0]}"/>'
        '<string name="pixel_format" value="luminance"/></film></sensor>'
    )
    # Lambertian wall of albedo 0.8: radiance E 0.8 / pi, summed over cells of the meter and rings of the pupil.
    u, v = np.meshgrid((np.arange(32) + 0.5) / 32 - 0.5, (np.arange(32) + 0.5) / 32 - 0.5)
    cell = np.stack([centre[0] - u * wide, centre[1] + v * tall, np.full_like(u, centre[2])], -1)
    across = np.cross(back, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, back)
    radius = 0.5 * pupil * np.sqrt((np.arange(8) + 0.5) / 8)
    turn = 2.0 * np.pi * np.arange(12) / 12
    lens = eye + (radius[:, None, None] * (np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * up)).reshape(-1, 3)
    way = lens - cell[..., None, :]
    distance = np.linalg.norm(way, axis=-1)
    cosines = (-way[..., 2] / distance) * (way @ back / distance)
    caught = (cosines / distance**2).mean(-1) * np.pi * (0.5 * pupil) ** 2
    return wall, camera, 0.8 / np.pi * caught * tall * wide / 1024 * scale**2 * efficiency


def _rectangle(name: str, half_width: float, half_height: float, placed: str, *inside: str) -> str:
    return (
        f'<shape type="rectangle" id="{name}"><transform name="to_world"><scale x="{half_width}" y="{half_height}"/>'
        f"{placed}</transform>{''.join(inside)}</shape>"
    )


def _diffuse(albedo: float) -> str:
    return f'<bsdf type="diffuse"><spectrum name="reflectance" value="{albedo}"/></bsdf>'
