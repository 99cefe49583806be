"""Drawing of a scene to scale: laser, spot, relay walls, object, occluders, camera, footprint, blocked and stray light."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from correlograph.files.drawing import Line, SceneDrawing
from sim.geometry import Geometry
from sim.plugins.laser import Laser

SURFACE_POINTS = 33
"""Points along each side of the grid that samples a surface."""

MIN_STRAY_FRACTION = 1e-3
"""Stray laser light, in units of the object's light, from which on its path is drawn."""

DIGITS = 6
"""Decimals of the drawn points in metres."""

SHAPE_COLOURS = {"virtual_source": "tab:green", "virtual_detector": "tab:blue", "hidden_object": "tab:red"}


def draw_scene(scene: mi.Scene, geometry: Geometry) -> SceneDrawing:
    """Draw a scene from above and from the side.

    The view from above shows the plane of spot, object and frame centre; the view from the side looks along the relay walls,
    parallel to that plane.
    """
    first, second, normal = _view_axes(geometry)
    surfaces = {shape.id(): _surface_points(shape) for shape in scene.shapes()}
    laser = next(emitter for emitter in scene.emitters() if isinstance(emitter, Laser))
    paths = _light_paths(np.asarray(laser.origin), {name: points.mean(0) for name, points in surfaces.items()}, geometry)

    def view(across: np.ndarray, up: np.ndarray) -> tuple[Line, ...]:
        def project(points: np.ndarray) -> np.ndarray:
            return (np.atleast_2d(points) - geometry.spot.centre) @ np.stack((across, up), 1)

        outlines = [
            Line(*_round_points(_outline(project(points))), name, _shape_colour(name), width=1.5, is_filled=True)
            for name, points in surfaces.items()
        ]
        return (*outlines, *(Line(*_round_points(project(points)), *drawn) for points, *drawn in paths))

    return SceneDrawing((view(first, second), view(first, normal)))


def _view_axes(geometry: Geometry) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit vectors along the relay walls, towards the object, and perpendicular to both."""
    along = geometry.camera.centre - geometry.spot.centre
    towards = geometry.hidden_object.centre - geometry.spot.centre
    normal = np.cross(along, towards)
    if np.linalg.norm(normal) < 1e-6 * np.linalg.norm(towards) ** 2:  # the three points lie on one line
        normal = np.cross(geometry.camera.right, towards)
    normal = normal / np.linalg.norm(normal)
    second = towards - (towards @ along) / max(along @ along, 1e-30) * along
    second = second / np.linalg.norm(second) if np.linalg.norm(second) > 1e-9 else towards / np.linalg.norm(towards)
    return np.cross(second, normal), second, normal


def _light_paths(laser: np.ndarray, centres: dict[str, np.ndarray], geometry: Geometry) -> list[tuple]:
    """Return points (n, 3), label, colour, style and width of each path and marker."""
    spot, detector, hidden = geometry.spot.centre, geometry.camera.centre, geometry.hidden_object.centre
    paths: list[tuple] = [
        (np.array([laser, spot]), "laser beam", "tab:green", "-", 1.5),
        (np.array([spot, hidden, detector]), "light by way of the object", "tab:red", "-", 1.0),
        (np.array([detector, geometry.camera.pupil_centre]), "camera axis", "tab:blue", "-", 1.0),
    ]
    direct = np.array([spot, detector])
    if geometry.is_direct_path_blocked:
        paths.append((direct, "direct light, blocked", "0.6", ":", 1.0))
    else:
        paths.append((direct, "direct light, NOT blocked", "tab:orange", "--", 1.5))
    if geometry.other_light_share > MIN_STRAY_FRACTION:
        label = f"stray light, {geometry.other_light_share:.2g} times the object's light"
        clutter = [centre for name, centre in centres.items() if not name.startswith(tuple(SHAPE_COLOURS))]
        for number, centre in enumerate(clutter):
            paths.append((np.array([spot, centre, detector]), "_" if number else label, "tab:orange", ":", 0.8))
    height, width = (0.5 * n * geometry.camera.pixel_pitch_m for n in geometry.camera.frame_shape)
    corners = [
        detector + row * height * geometry.camera.down + column * width * geometry.camera.right
        for row, column in ((-1, -1), (-1, 1), (1, 1), (1, -1), (-1, -1))
    ]
    paths.append((np.array(corners), "footprint of the camera", "tab:blue", "-", 2.5))
    return [*paths, (spot, "laser spot", "k", "*", 1.0), (geometry.camera.pupil_centre, "camera pupil", "k", "s", 1.0)]


def _surface_points(shape: mi.Shape) -> np.ndarray:
    """Return points on a surface, (n, 3): the vertices of a mesh, else a grid over its parameters, or the corners of its box where Mitsuba
    draws no points, as on instances and curves."""
    if isinstance(shape, mi.Mesh):
        return np.asarray(shape.vertex_positions_buffer(), np.float64).reshape(-1, 3)
    side = np.linspace(0.0, 1.0, SURFACE_POINTS, dtype=np.float32)
    u, v = (mi.Float(values.ravel()) for values in np.meshgrid(side, side))
    try:
        sampled = shape.sample_position(0.0, mi.Point2f(u, v)).p
    except RuntimeError:
        box = shape.bbox()
        return np.array([box.corner(number) for number in range(8)], np.float64).reshape(-1, 3)
    points = np.asarray(dr.ravel(sampled), np.float64).reshape(-1, 3)
    return points[np.isfinite(points).all(1)]


def _outline(points: np.ndarray) -> np.ndarray:
    """Return the closed convex outline (n, 2) of projected points; a line if they lie on one."""
    try:
        hull = ConvexHull(points).vertices
    except QhullError:
        direction = points[np.argmax(np.linalg.norm(points - points[0], axis=1))] - points[0]
        hull = np.argsort(points @ direction)[[0, -1]]
    return points[np.append(hull, hull[0])]


def _round_points(points: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    x, y = np.round(points, DIGITS).T.tolist()
    return tuple(x), tuple(y)


def _shape_colour(name: str) -> str:
    return next((colour for known, colour in SHAPE_COLOURS.items() if name.startswith(known)), "0.35")
