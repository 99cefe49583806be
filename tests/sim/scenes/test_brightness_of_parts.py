"""Autocorrelations of noise-free frames of shaded, deep, textured and veiled objects against sums over their surfaces.

The surfaces are sampled here in numpy: a point x of normal n, albedo r and area dA sends r cos_in cos_out dA / (d1 d2)^2,
and its fringes on the wall advance by u.step / lambda a pixel, u the direction to x. Nothing of the simulator's ray tracing
is used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import sim
from correlograph.lags import LAGS, lag_grid
from radiometry.autocorrelation import autocorrelate, smooth_by_window
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
from radiometry.prediction import patches_of
from scenes import scene_path
from sim.backend.variant import llvm_major
from sim.frame import Simulation
from sim.geometry import Geometry
from sim.plan import Settings

HALF_PLANE = lag_grid(LAGS).half_plane

NEW_LLVM = pytest.mark.skipif((llvm_major() or 99) < 17, reason="spheres and masks need libLLVM 17")
BARE = tuple((name, False) for name in ("shot_noise", "other_light", "detector_roughness", "pupil_and_pixel", "source_grain"))
FRAMES, CELLS = 40, 4
"""Cells per lag of the albedo from which the known autocorrelation is computed."""


@dataclass(frozen=True)
class Surface:
    """Points of a surface: (n, 3), (n, 3), (n,), (n,)."""

    position: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    area: np.ndarray


def plate(half: tuple[float, float], centre: tuple[float, float, float], tilt_deg: float, albedo: np.ndarray) -> Surface:
    """Rectangle turned about the y axis; `albedo` has its rows along +y and its columns along +x."""
    n = 480
    x, y = np.meshgrid((np.arange(n) + 0.5) / n * 2 - 1, (np.arange(n) + 0.5) / n * 2 - 1, indexing="ij")
    column, row = ((x + 1) / 2 * albedo.shape[1]).astype(int), ((1 + y) / 2 * albedo.shape[0]).astype(int)
    turn = np.deg2rad(tilt_deg)
    along = np.array([np.cos(turn), 0.0, -np.sin(turn)])
    position = half[0] * x[..., None] * along + half[1] * y[..., None] * np.array([0.0, 1.0, 0.0]) + np.array(centre)
    normal = np.broadcast_to([np.sin(turn), 0.0, np.cos(turn)], position.shape)
    area = np.full(x.size, 4.0 * half[0] * half[1] / x.size)
    return Surface(position.reshape(-1, 3), normal.reshape(-1, 3), albedo[row, column].ravel(), area)


def ball(radius: float, albedo: float) -> Surface:
    polar, azimuth = np.meshgrid((np.arange(500) + 0.5) / 500 * np.pi, (np.arange(1000) + 0.5) / 500 * np.pi, indexing="ij")
    normal = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1).reshape(-1, 3)
    area = np.sin(polar).ravel() * radius**2 * (np.pi / 500) ** 2
    return Surface(radius * normal, normal, np.full(len(area), albedo), area)


def joined(*parts: Surface) -> Surface:
    return Surface(*(np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])))


def rectangle(name: str, half: tuple[float, float], placed: str, surface: str) -> str:
    return (
        f'<shape type="rectangle" id="{name}"><transform name="to_world"><scale x="{half[0]}" y="{half[1]}"/>{placed}'
        f"</transform>{surface}</shape>"
    )


def diffuse(albedo: float) -> str:
    return f'<bsdf type="diffuse"><spectrum name="reflectance" value="{albedo}"/></bsdf>'


def deep() -> tuple[str, Surface]:
    near, far = (-0.004, 0.001, 0.1), (0.003, -0.002, -0.1)
    xml = [
        rectangle(f"hidden_object_{k}", (0.0015, 0.002), f'<translate x="{x}" y="{y}" z="{z}"/>', diffuse(0.8))
        for k, (x, y, z) in enumerate((near, far))
    ]
    full = np.full((1, 1), 0.8)
    return "".join(xml), joined(plate((0.0015, 0.002), near, 0.0, full), plate((0.0015, 0.002), far, 0.0, full))


def sphere() -> tuple[str, Surface]:
    xml = f'<shape type="sphere" id="hidden_object"><float name="radius" value="0.005"/>{diffuse(0.6)}</shape>'
    return xml, ball(0.005, 0.6)


def tilted() -> tuple[str, Surface]:
    import mitsuba as mi

    texture = np.random.default_rng(5).choice([0.0, 0.2, 0.9], (6, 5)).astype(np.float32)
    mi.Bitmap(texture[..., None]).write("texture.exr")
    surface = (
        '<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="texture.exr"/>'
        '<boolean name="raw" value="true"/><string name="filter_type" value="nearest"/></texture></bsdf>'
    )
    xml = rectangle("hidden_object", (0.006, 0.004), '<rotate y="1" angle="-55"/>', surface)
    return xml, plate((0.006, 0.004), (0.0, 0.0, 0.0), -55.0, texture)


def masked() -> tuple[str, Surface]:
    """A veil of opacity 0.3 before a plain plate, which it half covers: its shadow and what is seen through it count 0.7 each."""
    veil = f'<bsdf type="mask"><float name="opacity" value="0.3"/>{diffuse(0.8)}</bsdf>'
    xml = rectangle("hidden_object_1", (0.002, 0.003), '<translate x="-0.002" z="0.002"/>', veil) + rectangle(
        "hidden_object_2", (0.002, 0.003), '<translate y="0.001"/>', diffuse(0.8)
    )
    front = plate((0.002, 0.003), (-0.002, 0.0, 0.002), 0.0, np.full((1, 1), 0.24))
    back = plate((0.002, 0.003), (0.0, 0.001, 0.0), 0.0, np.full((1, 1), 0.8))
    through = back.albedo.copy()
    for end in (np.array([0.1039558, 0.0, 0.4890738]), np.array([0.0, 0.0, 1.0])):  # spot, frame's centre
        share = 0.002 / (end[2] - back.position[:, 2])
        x, y, _ = (back.position + share[:, None] * (end - back.position)).T
        through[(np.abs(x + 0.002) < 0.002) & (np.abs(y) < 0.003)] *= 0.7
    return xml, joined(front, replace(back, albedo=through))


def known_autocorrelation(geometry: Geometry, surface: Surface, *, shaded: bool = True) -> np.ndarray:
    """Window-smoothed r*r (127, 127) of a surface's light: mean over the patches, each of which sees it from its own place."""
    grid, _ = patches_of(geometry)
    rows, columns = (
        (np.arange(n) - 0.5 * (n - 1)) * size for n, size in zip((grid.rows, grid.columns), grid.patch_shape, strict=True)
    )
    lags = [
        _known_in_patch(geometry, surface, grid.patch_shape, geometry.camera.pixel_pitch_m * np.array([row, column]), shaded)
        for row in rows
        for column in columns
    ]
    return smooth_by_window(np.mean(lags, axis=0), CELLS, LAGS)


def _known_in_patch(
    geometry: Geometry, surface: Surface, patch_shape: tuple[int, int], offset_m: np.ndarray, shaded: bool
) -> np.ndarray:
    place = geometry.camera.centre + offset_m[0] * geometry.camera.down + offset_m[1] * geometry.camera.right
    way = surface.position - place
    to_wall, to_spot = -way, geometry.spot.centre - surface.position
    seen = (surface.normal * to_wall).sum(1) / np.linalg.norm(to_wall, axis=1)
    lit = (surface.normal * to_spot).sum(1) / np.linalg.norm(to_spot, axis=1)
    # The two walls are Lambertian and far away: their cosines, which change with depth, belong to the light as well.
    walls = (
        -to_spot
        @ geometry.spot.normal
        / np.linalg.norm(to_spot, axis=1)
        * (way @ wall_normal(geometry))
        / np.linalg.norm(way, axis=1)
    )
    light = surface.albedo * surface.area * np.clip(seen, 0, None) * np.clip(lit, 0, None)
    light *= walls / ((to_spot**2).sum(1) * (way**2).sum(1))
    if not shaded:
        light = np.where((light > 0.0) & (surface.albedo > 0.0), 1.0, 0.0)
    direction = way / np.linalg.norm(way, axis=1, keepdims=True)
    turns = (
        np.stack([direction @ step for step in (geometry.camera.down, geometry.camera.right)], 1)
        * geometry.camera.pixel_pitch_m
    )
    cell = turns / geometry.wavelength_m * np.array(patch_shape) * CELLS
    cell = np.round(cell - 0.5 * (cell.max(0) + cell.min(0)) + 256).astype(int)
    r = np.zeros((512, 512))
    np.add.at(r, tuple(cell.T), light)
    return autocorrelate(r)


def wall_normal(geometry: Geometry) -> np.ndarray:
    normal = np.cross(geometry.camera.right, geometry.camera.down)
    normal /= np.linalg.norm(normal)
    return normal * np.sign(normal @ (-geometry.camera.centre))


def distance(estimate: np.ndarray, known: np.ndarray) -> float:
    """Relative L2 distance over the lags but zero, after one gain."""
    a, b = estimate[HALF_PLANE].astype(np.float64), known[HALF_PLANE]
    a = a * ((a * b).sum() / (a * a).sum())
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


@pytest.mark.slow
@pytest.mark.parametrize("make", [pytest.param(sphere, marks=NEW_LLVM), deep, tilted, pytest.param(masked, marks=NEW_LLVM)])
def test_noise_free_frames_show_the_autocorrelation_of_the_surface_light(make, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    xml, surface = make()
    text = scene_path("corner_letter").read_text()
    begin = text.index('<shape type="rectangle" id="hidden_object">')
    end = text.index("</shape>", begin) + len("</shape>")
    text = (text[:begin] + xml + text[end:]).replace('value="2464"', 'value="1232"').replace('value="2056"', 'value="1028"')
    (tmp_path / "scene.xml").write_text(text)
    geometry = sim.load(tmp_path / "scene.xml").geometry
    simulation = Simulation(geometry, Settings(effects=BARE))
    grid, _ = patches_of(geometry)
    estimate, dof = estimate_autocorrelation((simulation.expected_frame(6, number) for number in range(FRAMES)), grid)
    known, flat = known_autocorrelation(geometry, surface), known_autocorrelation(geometry, surface, shaded=False)
    # Every lag has the variance signal^2 / K.
    print(distance(estimate, known) * dof**0.5, distance(estimate, flat) * dof**0.5)
    assert distance(estimate, known) < 1.15 / dof**0.5
    assert distance(estimate, flat) > 1.5 / dof**0.5
