"""Reader of a loaded scene: validates it and returns its Geometry."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from correlograph.errors import InputError, memory_bytes
from correlograph.lags import LAG_SIDE
from radiometry.throughput import LightPath, closed_form
from sim.backend.variant import check_compilable
from sim.geometry import Geometry, Spot
from sim.plugins.laser import Laser
from sim.plugins.phase_screen import PhaseScreen
from sim.plugins.speckle_camera import SpeckleCamera
from sim.transport.ambient import ambient_irradiance
from sim.transport.detector_texture import detector_albedo, texture_of
from sim.transport.footprint import GRAZING, lag_axes, pixel_steps
from sim.transport.hidden_object import HiddenObject, bounds, is_hidden_object
from sim.transport.light_transport import LightTransport
from sim.transport.monte_carlo import estimate_other_light
from sim.transport.surfaces import check_energy, check_surfaces

BYTES_PER_PIXEL = 64
"""Measured memory of a simulation per pixel of the film."""


def fingerprint(scene: mi.Scene) -> int:
    """Return a number that changes when `mi.traverse` changes anything in a scene."""
    return hash(
        tuple(
            (key, np.asarray(value).tobytes() if hasattr(value, "__array__") or dr.is_array_v(value) else str(value))
            for key, value in mi.traverse(scene).items()
        )
    )


def read_geometry(scene: mi.Scene, sensor: SpeckleCamera | None = None) -> Geometry:
    """Read the geometry of a scene. Raises InputError that names what is missing or impossible.

    Args:
        sensor: the camera; the only speckle_camera of the scene if None.
    """
    check_compilable(scene)
    check_surfaces(scene)
    shapes = {shape.id(): shape for shape in scene.shapes()}
    # Shapes of a scene file always have names; shapes merged by Mitsuba have none.
    if any(shape.class_name() == "Mesh" and not shape.id() for shape in scene.shapes()):
        raise InputError(
            "scene", "separate shapes with their ids", "shapes merged by Mitsuba", "pass optimize=False to mi.load_file"
        )
    source = _shape(shapes, "virtual_source")
    detector = _shape(shapes, "virtual_detector")
    laser = _only(scene.emitters(), Laser, "laser")
    camera = sensor if isinstance(sensor, SpeckleCamera) else _only(scene.sensors(), SpeckleCamera, "speckle_camera")
    hidden_shapes = [shape for shape in scene.shapes() if is_hidden_object(shape)]
    if not hidden_shapes:
        raise InputError(
            "hidden_object",
            "at least one shape whose id starts with hidden_object",
            sorted(shapes),
            "add one, and pass optimize=False to mi.load_file",
        )

    spot_point, source_normal, source_albedo = _first_hit(scene, laser.origin, laser.direction, source, "the laser beam")
    detector_centre, detector_normal, _ = _first_hit(
        scene, camera.pupil_centre, camera.axis, detector, "the axis of the speckle_camera"
    )
    height, width = _film_size(camera)
    _check_spot_fits(scene, laser, source)
    right, down = pixel_steps(camera.axis, camera.up, _facing(detector_normal, camera.axis, "the speckle_camera"))
    wall_albedo, texture = texture_of(detector_albedo(scene, detector, camera, detector_centre, right, down, (height, width)))

    centre = 0.5 * np.sum(bounds(hidden_shapes), axis=0)
    line = _unit(centre - detector_centre)
    _facing(detector_normal, line, "the hidden_object")
    transport = LightTransport(scene, laser, camera, detector_centre, right, down, (height, width), wall_albedo)
    hidden_object = HiddenObject(transport, centre, lag_axes(right, down, line))
    to_source, to_detector = hidden_object.centre - spot_point, detector_centre - hidden_object.centre
    to_pupil = camera.pupil_centre - detector_centre
    screen = source.bsdf()
    if not isinstance(screen, PhaseScreen):
        raise InputError("virtual_source", "a phase_screen BSDF", type(screen).__name__, "wrap its BSDF in a phase_screen")
    path = _light_path(
        laser,
        camera,
        hidden_object,
        (source_normal, source_albedo),
        (detector_normal, wall_albedo),
        to_source,
        to_detector,
        to_pupil,
        abs(float(np.linalg.norm(np.cross(right, down)))),
        height * width,
    )
    flat = closed_form(path).per_pixel
    if flat > 0.0 and hidden_object.throughput > 0.0:
        path = replace(path, beyond_flat=hidden_object.throughput / flat)
    return Geometry(
        spot=Spot(
            spot_point,
            laser.spot_diameter_m,
            screen.height_rms_m,
            screen.correlation_length_m,
            laser.scan_step_m,
            laser.scan_speed_m_s,
            laser.direction,
            source_normal,
        ),
        hidden_object=hidden_object,
        detector_centre=detector_centre,
        pupil_centre=camera.pupil_centre,
        right=right,
        down=down,
        frame_shape=(height, width),
        pixel_pitch_m=camera.pixel_pitch_m,
        pupil_diameter_m=camera.pupil_diameter_m,
        pupil_distance_m=path.detector_to_pupil_m,
        electronics=camera.electronics,
        light_path=path,
        is_direct_path_blocked=is_blocked(scene, spot_point, detector_centre),
        linewidth_hz=laser.linewidth_hz,
        is_depolarised=any(
            isinstance(shape.bsdf(), PhaseScreen) and shape.bsdf().depolarising
            for shape in scene.shapes()
            if shape.id() == "virtual_source" or is_hidden_object(shape)
        ),
        detector_height_rms_m=detector.bsdf().height_rms_m if isinstance(detector.bsdf(), PhaseScreen) else None,
        detector_texture=texture,
        ambient_irradiance=ambient_irradiance(
            scene, detector_centre, right, down, detector_normal, (height * camera.pixel_pitch_m, width * camera.pixel_pitch_m)
        ),
        object_velocity_m_s=_velocity(hidden_shapes),
        frame_interval_s=camera.frame_interval_s,
        other_light=estimate_other_light(scene, camera=camera),
        direct_light=_direct_light(scene, path.source_albedo, spot_point, source_normal, detector_centre, detector_normal),
    )


def _light_path(
    laser: Laser,
    camera: SpeckleCamera,
    hidden_object: HiddenObject,
    source: tuple[np.ndarray, float],
    detector: tuple[np.ndarray, float],
    to_source: np.ndarray,
    to_detector: np.ndarray,
    to_pupil: np.ndarray,
    stretch: float,
    pixels: int,
) -> LightPath:
    """Return the input of the closed-form light budget.

    Args:
        source, detector: normal and albedo of the relay walls.
        to_source, to_detector: vectors from spot to object and from object to frame centre.
        to_pupil: vector from the frame centre to the pupil.
        stretch: area of a pixel's footprint in units of the squared pitch.
    """
    (source_normal, source_albedo), (detector_normal, wall_albedo) = source, detector
    cosines = hidden_object.mean_cosines()
    return LightPath(
        wavelength_m=laser.wavelength_m,
        power_w=laser.power_w,
        source_albedo=min(source_albedo, 1.0),
        source_cosine=_cosine(source_normal, to_source),
        source_to_object_m=float(np.linalg.norm(to_source)),
        object_cosine_in=cosines[0],
        object_albedo_area_m2=hidden_object.albedo_area_m2(),
        object_cosine_out=cosines[1],
        object_to_detector_m=float(np.linalg.norm(to_detector)),
        detector_cosine_in=_cosine(detector_normal, -to_detector),
        detector_albedo=min(wall_albedo, 1.0),
        detector_cosine_out=_cosine(detector_normal, to_pupil),
        detector_to_pupil_m=float(np.linalg.norm(to_pupil)),
        pupil_diameter_m=camera.pupil_diameter_m,
        pupil_cosine=_cosine(camera.axis, -to_pupil),
        transmission=camera.transmission,
        quantum_efficiency=camera.electronics.quantum_efficiency,
        pixel_area_m2=camera.pixel_pitch_m**2 * stretch,
        pixels=pixels,
    )


def _shape(shapes: dict[str, mi.Shape], name: str) -> mi.Shape:
    if name not in shapes:
        raise InputError(
            name, f"a shape with id {name}", f"only {sorted(shapes)}", "add it, and pass optimize=False to mi.load_file"
        )
    return shapes[name]


def _only(plugins: list, kind: type, name: str):
    found = [plugin for plugin in plugins if isinstance(plugin, kind)]
    if len(found) != 1:
        raise InputError(name, f"exactly one {name} in the scene", len(found), "add or remove one")
    return found[0]


def _first_hit(
    scene: mi.Scene, origin: np.ndarray, direction: np.ndarray, expected: mi.Shape, ray_name: str
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the point, outward normal and diffuse albedo at which a ray first meets the scene, which must be `expected`."""
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(*origin.tolist()), mi.Vector3f(*direction.tolist())))
    if not bool(hit.is_valid()[0]):
        raise InputError(expected.id(), f"{ray_name} to meet it", "nothing there", "correct the to_world transforms")
    if hit.shape[0] != expected:
        raise InputError(expected.id(), f"{ray_name} to meet it", f"{hit.shape[0].id()} in the way", "move one of them")
    distance = float(hit.t[0])
    check_energy(expected.id(), hit, hit.is_valid())
    normal = np.asarray(hit.n, np.float64).reshape(3)
    albedo = float(np.asarray(hit.bsdf().eval_diffuse_reflectance(hit)).reshape(-1)[0])
    if normal @ direction > 0.0:
        raise InputError(expected.id(), f"{ray_name} to meet its front", "its back", "turn the shape round")
    return origin + distance * direction, _unit(normal), albedo


def _film_size(camera: SpeckleCamera) -> tuple[int, int]:
    """Return rows and columns of the film, which must not be cropped and must hold one patch of all lags."""
    film = camera.film()
    height, width = int(film.size()[1]), int(film.size()[0])
    if [int(n) for n in film.crop_size()] != [width, height]:
        raise InputError("film", "the whole film", f"a crop of {film.crop_size()}", "set width and height instead")
    if min(height, width) < LAG_SIDE:
        raise InputError("film", f"at least {LAG_SIDE} x {LAG_SIDE} pixels (one patch)", f"{width} x {height}", "enlarge it")
    if height * width * BYTES_PER_PIXEL > memory_bytes():
        raise InputError(
            "film",
            f"a frame that fits into {memory_bytes() / 1e9:.1f} GB",
            f"{width} x {height} pixels, about {height * width * BYTES_PER_PIXEL / 1e9:.3g} GB",
            "choose a smaller film",
        )
    return height, width


def _check_spot_fits(scene: mi.Scene, laser: Laser, source: mi.Shape) -> None:
    """Check that the whole beam meets the virtual source."""
    across = _unit(np.cross(laser.direction, [0.577, 0.211, 0.789]))
    up = np.cross(laser.direction, across)
    for turn in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
        edge = laser.origin + 0.5 * laser.spot_diameter_m * (np.cos(turn) * across + np.sin(turn) * up)
        _first_hit(scene, edge, laser.direction, source, "the edge of the laser beam")


def _direct_light(
    scene: mi.Scene,
    source_albedo: float,
    spot: np.ndarray,
    source_normal: np.ndarray,
    detector: np.ndarray,
    detector_normal: np.ndarray,
) -> float:
    way = detector - spot
    cosines = max(_cosine_signed(source_normal, way), 0.0) * max(_cosine_signed(detector_normal, -way), 0.0)
    if cosines == 0.0 or is_blocked(scene, spot, detector):
        return 0.0
    return source_albedo * cosines / (np.pi * float(way @ way))


def _velocity(shapes: list[mi.Shape]) -> np.ndarray:
    """Return the velocity of the hidden object. Raises InputError if its parts move apart."""
    found = np.array([shape.bsdf().velocity_m_s if isinstance(shape.bsdf(), PhaseScreen) else np.zeros(3) for shape in shapes])
    if np.ptp(found, axis=0).any():
        raise InputError("hidden_object", "one velocity for all of its shapes", found.tolist(), "correct their phase_screens")
    return found[0]


def _facing(normal: np.ndarray, direction: np.ndarray, name: str) -> np.ndarray:
    """Return the normal of a wall. Raises InputError if `direction` is more than 87 degrees from it."""
    cosine = abs(float(normal @ direction))
    if cosine < GRAZING:
        raise InputError(
            "virtual_detector",
            f"{name} at most {np.degrees(np.arccos(GRAZING)):.0f} degrees off its normal",
            f"{np.degrees(np.arccos(cosine)):.1f} degrees",
            "turn one of them",
        )
    return normal


def is_blocked(scene: mi.Scene, start: np.ndarray, end: np.ndarray) -> bool:
    """Return whether a shape blocks the line between two points, without the surfaces of the end points."""
    way = end - start
    ray = mi.Ray3f(mi.Point3f(*(start + 1e-4 * way).tolist()), mi.Vector3f(*_unit(way).tolist()))
    ray.maxt = float(np.linalg.norm(way)) * (1.0 - 2e-4)
    return bool(scene.ray_test(ray)[0])


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _cosine_signed(normal: np.ndarray, way: np.ndarray) -> float:
    return float(normal @ way / (np.linalg.norm(normal) * np.linalg.norm(way)))


def _cosine(normal: np.ndarray, way: np.ndarray) -> float:
    """Return the cosine between a normal and a direction, zero if it points behind the surface."""
    return min(max(_cosine_signed(normal, way), 0.0), 1.0)
