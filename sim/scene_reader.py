"""Reader of a loaded scene: validates it and returns its Geometry."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from correlograph.errors import InputError
from radiometry.light_budget_rows import LightPath, closed_form
from sim.backend.variant import check_compilable
from sim.camera_view import CameraView
from sim.geometry import Geometry, Movement, PhotographedWall, Spot
from sim.phase_screens import check_phase_screens, is_depolarised, moving_together
from sim.plugins.laser import Laser
from sim.plugins.phase_screen import PhaseScreen
from sim.plugins.speckle_camera import SpeckleCamera
from sim.scene_checks import (
    check_facing,
    check_numbers,
    check_spot_fits,
    cosine_between,
    direct_light,
    film_size,
    first_hit,
    is_blocked,
    only_plugin,
    shape_named,
    unit,
)
from sim.transport.ambient import ambient_irradiance
from sim.transport.detector_texture import detector_albedo, texture_of
from sim.transport.footprint import lag_axes, pixel_steps
from sim.transport.hidden_object import HiddenObject, bounds, is_hidden_object
from sim.transport.light_transport import LightTransport
from sim.transport.monte_carlo import estimate_other_light
from sim.transport.surfaces import check_surfaces


def fingerprint(scene: mi.Scene) -> int:
    """Return a number that changes when `mi.traverse` changes anything in a scene."""
    return hash(
        tuple(
            (key, np.asarray(value).tobytes() if hasattr(value, "__array__") or dr.is_array_v(value) else str(value))
            for key, value in mi.traverse(scene).items()
        )
    )


@dataclass(frozen=True)
class _WallPoint:
    """A point of a relay wall, with normal and albedo."""

    place: np.ndarray
    normal: np.ndarray
    albedo: float


def read_geometry(scene: mi.Scene, sensor: SpeckleCamera | None = None) -> Geometry:
    """Read the geometry of a scene. Raises InputError that names what is missing or impossible.

    Args:
        sensor: the camera; the only speckle_camera of the scene if None.
    """
    source, detector, hidden_shapes, laser, camera = _find_parts(scene, sensor)
    lit = _WallPoint(*first_hit(scene, laser.origin, laser.direction, source, "the laser beam"))
    check_spot_fits(scene, laser, source)
    seen = _WallPoint(*first_hit(scene, camera.pupil_centre, camera.axis, detector, "the axis of the speckle_camera"))
    view = _view(camera, seen)
    wall_albedo, wall = _photographed_wall(scene, detector, view, seen)
    seen = replace(seen, albedo=wall_albedo)

    centre = 0.5 * np.sum(bounds(hidden_shapes), axis=0)
    line = unit(centre - seen.place)
    check_facing(seen.normal, line, "the hidden_object")
    moving = moving_together(hidden_shapes)
    hidden_object = HiddenObject(
        LightTransport(scene, laser, camera, view, wall_albedo),
        centre,
        lag_axes(view.right, view.down, line),
        [shapes for shapes, _ in moving],
    )
    path = _light_path(laser, camera, hidden_object, lit, seen, view)
    return Geometry(
        spot=_spot(laser, source, lit),
        hidden_object=hidden_object,
        wall=wall,
        camera=view,
        light_path=path,
        is_direct_path_blocked=is_blocked(scene, lit.place, seen.place),
        direct_light=direct_light(scene, path.source_albedo, (lit.place, lit.normal), (seen.place, seen.normal)),
        is_depolarised=is_depolarised(source, hidden_shapes, camera),
        movements=tuple(Movement(path, 0.5 * np.sum(bounds(shapes), axis=0)) for shapes, path in moving),
        other_light=estimate_other_light(scene, camera=camera),
    )


def _find_parts(
    scene: mi.Scene, sensor: SpeckleCamera | None
) -> tuple[mi.Shape, mi.Shape, list[mi.Shape], Laser, SpeckleCamera]:
    """Return virtual source, virtual detector, shapes of the hidden object, laser and camera. Raises InputError for a
    missing one."""
    check_compilable(scene)
    check_numbers(scene)
    check_surfaces(scene)
    shapes = {shape.id(): shape for shape in scene.shapes()}
    # Shapes of a scene file always have names; shapes merged by Mitsuba have none.
    if any(shape.class_name() == "Mesh" and not shape.id() for shape in scene.shapes()):
        raise InputError(
            "scene", "separate shapes with their ids", "shapes merged by Mitsuba", "pass optimize=False to mi.load_file"
        )
    source = shape_named(shapes, "virtual_source")
    detector = shape_named(shapes, "virtual_detector")
    laser = only_plugin(scene.emitters(), Laser, "laser")
    camera = sensor if isinstance(sensor, SpeckleCamera) else only_plugin(scene.sensors(), SpeckleCamera, "speckle_camera")
    hidden_shapes = [shape for shape in scene.shapes() if is_hidden_object(shape)]
    if not hidden_shapes:
        raise InputError(
            "hidden_object",
            "at least one shape whose id starts with hidden_object",
            sorted(shapes),
            "add one, and pass optimize=False to mi.load_file",
        )
    for shape in (source, detector, *hidden_shapes):
        if shape.class_name() == "Instance":  # rays meet the shapes of its group, which have other names
            raise InputError(shape.id(), "a shape", "an instance of a shapegroup", "write the shape itself in its place")
    check_phase_screens(scene, hidden_shapes)
    return source, detector, hidden_shapes, laser, camera


def _view(camera: SpeckleCamera, seen: _WallPoint) -> CameraView:
    """Return the camera with its pixels on the virtual detector. Raises InputError for a cropped film and grazing incidence."""
    right, down = pixel_steps(camera.axis, camera.up, check_facing(seen.normal, camera.axis, "the speckle_camera"))
    return CameraView(
        pupil_centre=camera.pupil_centre,
        centre=seen.place,
        right=right,
        down=down,
        frame_shape=film_size(camera),
        pixel_pitch_m=camera.pixel_pitch_m,
        pupil_diameter_m=camera.pupil_diameter_m,
        electronics=camera.electronics,
        frame_interval_s=camera.frame_interval_s,
        polarisation_channels=camera.polarisation_channels,
        trajectory=camera.trajectory,
    )


def _photographed_wall(
    scene: mi.Scene, detector: mi.Shape, view: CameraView, seen: _WallPoint
) -> tuple[float, PhotographedWall]:
    """Return the mean albedo of the virtual detector inside the frame, and what else the camera sees of it."""
    albedo, texture = texture_of(detector_albedo(scene, detector, view))
    screen = detector.bsdf()
    height_rms_m = screen.height_rms_m if isinstance(screen, PhaseScreen) else None
    return albedo, PhotographedWall(height_rms_m, texture, ambient_irradiance(scene, view, seen.normal))


def _spot(laser: Laser, source: mi.Shape, lit: _WallPoint) -> Spot:
    """Return the laser spot on the virtual source. Raises InputError for a wall without a phase screen."""
    screen = source.bsdf()
    if not isinstance(screen, PhaseScreen):
        raise InputError("virtual_source", "a phase_screen BSDF", type(screen).__name__, "wrap its BSDF in a phase_screen")
    return Spot(
        lit.place,
        laser.spot_diameter_m,
        screen.height_rms_m,
        screen.correlation_length_m,
        laser.scan_step_m,
        laser.scan_speed_m_s,
        laser.direction,
        lit.normal,
        laser.linewidth_hz,
    )


def _light_path(
    laser: Laser, camera: SpeckleCamera, hidden_object: HiddenObject, lit: _WallPoint, seen: _WallPoint, view: CameraView
) -> LightPath:
    """Return the input of the closed-form light budget: from the lit point by the object to the frame centre and the pupil."""
    to_source, to_detector = hidden_object.centre - lit.place, seen.place - hidden_object.centre
    to_pupil = view.pupil_centre - seen.place
    cosines = hidden_object.mean_cosines()
    path = LightPath(
        wavelength_m=laser.wavelength_m,
        power_w=laser.power_w,
        source_albedo=min(lit.albedo, 1.0),
        source_cosine=cosine_between(lit.normal, to_source),
        source_to_object_m=float(np.linalg.norm(to_source)),
        object_cosine_in=cosines[0],
        object_albedo_area_m2=hidden_object.albedo_area_m2(),
        object_cosine_out=cosines[1],
        object_to_detector_m=float(np.linalg.norm(to_detector)),
        detector_cosine_in=cosine_between(seen.normal, -to_detector),
        detector_albedo=min(seen.albedo, 1.0),
        detector_cosine_out=cosine_between(seen.normal, to_pupil),
        detector_to_pupil_m=view.pupil_distance_m,
        pupil_diameter_m=view.pupil_diameter_m,
        pupil_cosine=cosine_between(camera.axis, -to_pupil),
        transmission=camera.transmission,
        quantum_efficiency=view.electronics.quantum_efficiency,
        pixel_area_m2=view.pixel_pitch_m**2 * view.footprint,
        pixels=view.frame_shape[0] * view.frame_shape[1],
    )
    flat = closed_form(path).per_pixel
    if flat > 0.0 and hidden_object.throughput > 0.0:
        path = replace(path, beyond_flat=hidden_object.throughput / flat)
    return path
