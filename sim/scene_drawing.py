"""Drawing of a scene to scale: laser, spot, relay walls, object, occluders, camera, footprint, blocked and stray light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from sim.geometry import Geometry
from sim.plugins.laser import Laser

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SURFACE_POINTS = 33
"""Points along each side of the grid that samples a surface."""

MIN_STRAY_FRACTION = 1e-3
"""Stray laser light, in units of the object's light, from which on its path is drawn."""

COLOURS = {"virtual_source": "tab:green", "virtual_detector": "tab:blue", "hidden_object": "tab:red"}


def draw_scene(scene: mi.Scene, geometry: Geometry, name: str) -> Figure:
    """Draw a scene from above and from the side.

    The view from above shows the plane of spot, object and frame centre; the view from the side is along that plane.
    """
    from matplotlib.figure import Figure

    first, second, normal = _view_axes(geometry)
    figure = Figure(figsize=(12.0, 5.6), layout="constrained")
    views = figure.subplots(1, 2)
    for axes, title, across, up in (
        (views[0], "from above", first, second),
        (views[1], "from the side", first, normal),
    ):
        _draw_view(axes, scene, geometry, across, up)
        axes.set_title(f"{name or 'scene'} {title}", fontsize=10)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.12)
        axes.grid(color="0.9", lw=0.5)
        axes.set_xlabel("m")
        axes.set_ylabel("m")
    handles, labels = views[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def _view_axes(geometry: Geometry) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit vectors along the relay walls, towards the object, and perpendicular to both."""
    along = geometry.detector_centre - geometry.spot.centre
    towards = geometry.hidden_object.centre - geometry.spot.centre
    normal = np.cross(along, towards)
    if np.linalg.norm(normal) < 1e-6 * np.linalg.norm(towards) ** 2:  # the three points lie on one line
        normal = np.cross(geometry.right, towards)
    normal = normal / np.linalg.norm(normal)
    second = towards - (towards @ along) / max(along @ along, 1e-30) * along
    second = second / np.linalg.norm(second) if np.linalg.norm(second) > 1e-9 else towards / np.linalg.norm(towards)
    return np.cross(second, normal), second, normal


def _draw_view(axes: Axes, scene: mi.Scene, geometry: Geometry, across: np.ndarray, up: np.ndarray) -> None:
    def project(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        points = np.atleast_2d(points) - geometry.spot.centre
        return points @ across, points @ up

    centres = {}
    for number, shape in enumerate(scene.shapes()):
        points = _surface_points(shape)
        centres[shape.id()] = points.mean(0)
        colour = next((value for name, value in COLOURS.items() if shape.id().startswith(name)), "0.35")
        _draw_outline(axes, *project(points), colour)
        x, y = project(centres[shape.id()])
        axes.annotate(
            shape.id(), (x[0], y[0]), fontsize=8, color=colour, xytext=(4, 5 if number % 2 else -11), textcoords="offset points"
        )

    def path(points: list[np.ndarray], label: str, **style: object) -> None:
        axes.plot(*project(np.array(points)), label=label, **style)

    spot, detector, hidden = geometry.spot.centre, geometry.detector_centre, geometry.hidden_object.centre
    laser = next(emitter for emitter in scene.emitters() if isinstance(emitter, Laser))
    path([np.asarray(laser.origin), spot], "laser beam", color="tab:green", lw=1.5)
    path([spot, hidden, detector], "light by way of the object", color="tab:red", lw=1.0)
    path([detector, geometry.pupil_centre], "camera axis", color="tab:blue", lw=1.0)
    if geometry.is_direct_path_blocked:
        path([spot, detector], "direct light, blocked", color="0.6", lw=1.0, ls=":")
    else:
        path([spot, detector], "direct light, NOT blocked", color="tab:orange", lw=1.5, ls="--")
    if geometry.other_light_share > MIN_STRAY_FRACTION:
        label = f"stray light, {geometry.other_light_share:.2g} times the object's light"
        clutter = [name for name in centres if not name.startswith(tuple(COLOURS))]
        for number, name in enumerate(clutter):
            path([spot, centres[name], detector], label if number == 0 else "_", color="tab:orange", lw=0.8, ls=":")
    height, width = (0.5 * n * geometry.pixel_pitch_m for n in geometry.frame_shape)
    corners = [
        detector + row * height * geometry.down + column * width * geometry.right
        for row, column in ((-1, -1), (-1, 1), (1, 1), (1, -1), (-1, -1))
    ]
    path(corners, "footprint of the camera", color="tab:blue", lw=2.5)
    for point, label, marker in ((spot, "laser spot", "*"), (geometry.pupil_centre, "camera pupil", "s")):
        x, y = project(point)
        axes.plot(x, y, marker, color="k", ms=6, label=label)


def _surface_points(shape: mi.Shape) -> np.ndarray:
    """Return points on a surface, (n, 3): the vertices of a mesh, else a grid over its parameters."""
    if isinstance(shape, mi.Mesh):
        return np.asarray(shape.vertex_positions_buffer(), np.float64).reshape(-1, 3)
    side = np.linspace(0.0, 1.0, SURFACE_POINTS, dtype=np.float32)
    u, v = (mi.Float(values.ravel()) for values in np.meshgrid(side, side))
    sampled = shape.sample_position(0.0, mi.Point2f(u, v)).p
    points = np.asarray(dr.ravel(sampled), np.float64).reshape(-1, 3)
    return points[np.isfinite(points).all(1)]


def _draw_outline(axes: Axes, x: np.ndarray, y: np.ndarray, colour: str) -> None:
    """Draw the convex outline of projected points; a line if they lie on one."""
    points = np.stack((x, y), 1)
    try:
        hull = ConvexHull(points).vertices
    except QhullError:
        direction = points[np.argmax(np.linalg.norm(points - points[0], axis=1))] - points[0]
        hull = np.argsort(points @ direction)[[0, -1]]
    outline = points[np.append(hull, hull[0])]
    axes.fill(outline[:, 0], outline[:, 1], color=colour, alpha=0.15, lw=0)
    axes.plot(outline[:, 0], outline[:, 1], color=colour, lw=1.5)
