"""Rays and sizes of a scene: which shapes the axes of laser and camera meet, whether light is blocked, and whether film and
spot fit.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from correlograph.errors import InputError, memory_bytes
from correlograph.lags import LAG_SIDE
from sim.plugins.laser import Laser
from sim.plugins.speckle_camera import SpeckleCamera
from sim.transport.footprint import GRAZING
from sim.transport.surfaces import check_energy

BYTES_PER_PIXEL = 64
"""Measured memory of a simulation per pixel of the film."""


def damaged_mesh(scene: mi.Scene) -> InputError | None:
    """Return the error of the first mesh that has no faces, or faces of vertices that it lacks.

    As long as a mesh without faces exists, rays fail in every scene: Mitsuba compiles the intersection with all meshes of the process.
    """
    for shape in scene.shapes():
        if not isinstance(shape, mi.Mesh):
            continue
        found, count = "", shape.vertex_count()
        if shape.face_count() == 0:
            found = "one without faces"
        elif (last := int(np.asarray(shape.faces_buffer()).max())) >= count:
            found = f"a face of vertex {last} of {count}"
        if found:
            return InputError(
                shape.id() or "shape", "a mesh of triangles between its own vertices", found, "export the mesh again"
            )
    return None


def check_numbers(scene: mi.Scene) -> None:
    """Raise InputError for a damaged mesh, a shape or a parameter that is not finite, and a negative reflectance."""
    if damaged := damaged_mesh(scene):
        raise damaged
    for shape in scene.shapes():
        if not np.isfinite(np.array([shape.bbox().min, shape.bbox().max], np.float64)).all():
            raise InputError(shape.id() or "shape", "finite sizes", "NaN or infinity", "correct the shape")
    for name, value in mi.traverse(scene).items():
        if not (dr.is_array_v(value) or isinstance(value, float)):
            continue
        numbers = np.asarray(value)
        if numbers.dtype.kind != "f" or numbers.size == 0:
            continue
        if not np.isfinite(numbers).all():
            raise InputError(name, "finite numbers", "NaN or infinity", "correct the scene or the file that it reads")
        if "reflectance" in name and numbers.min() < 0.0:
            raise InputError(name, "a reflectance of zero or more", f"{numbers.min():g}", "correct the scene or its texture")


def shape_named(shapes: dict[str, mi.Shape], name: str) -> mi.Shape:
    """Return the shape of an id. Raises InputError if there is none."""
    if name not in shapes:
        raise InputError(
            name, f"a shape with id {name}", f"only {sorted(shapes)}", "add it, and pass optimize=False to mi.load_file"
        )
    return shapes[name]


def only_plugin(plugins: list, kind: type, name: str):
    """Return the only plugin of a kind. Raises InputError for none or several."""
    found = [plugin for plugin in plugins if isinstance(plugin, kind)]
    if len(found) != 1:
        raise InputError(name, f"exactly one {name} in the scene", len(found), "add or remove one")
    return found[0]


def first_hit(
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
    return origin + distance * direction, unit(normal), albedo


def film_size(camera: SpeckleCamera) -> tuple[int, int]:
    """Return rows and columns of the film, which must not be cropped and must be large enough for one patch that has all
    lags.
    """
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


def check_spot_fits(scene: mi.Scene, laser: Laser, source: mi.Shape) -> None:
    """Check that the whole beam meets the virtual source."""
    across = unit(np.cross(laser.direction, [0.577, 0.211, 0.789]))
    up = np.cross(laser.direction, across)
    for turn in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
        edge = laser.origin + 0.5 * laser.spot_diameter_m * (np.cos(turn) * across + np.sin(turn) * up)
        first_hit(scene, edge, laser.direction, source, "the edge of the laser beam")


def direct_light(
    scene: mi.Scene,
    source_albedo: float,
    source: tuple[np.ndarray, np.ndarray],
    detector: tuple[np.ndarray, np.ndarray],
) -> float:
    """Return the irradiance of the frame centre by light straight from the spot, not via the object, divided by the laser
    power, in 1/m^2.

    Args:
        source, detector: spot and frame centre, each with the normal of its wall.
    """
    (spot, source_normal), (centre, detector_normal) = source, detector
    way = centre - spot
    cosines = max(_cosine_signed(source_normal, way), 0.0) * max(_cosine_signed(detector_normal, -way), 0.0)
    if cosines == 0.0 or is_blocked(scene, spot, centre):
        return 0.0
    return source_albedo * cosines / (np.pi * float(way @ way))


def check_facing(normal: np.ndarray, direction: np.ndarray, name: str) -> np.ndarray:
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
    ray = mi.Ray3f(mi.Point3f(*(start + 1e-4 * way).tolist()), mi.Vector3f(*unit(way).tolist()))
    ray.maxt = float(np.linalg.norm(way)) * (1.0 - 2e-4)
    return bool(scene.ray_test(ray)[0])


def unit(vector: np.ndarray) -> np.ndarray:
    """Return a vector of length 1 in the same direction."""
    return vector / np.linalg.norm(vector)


def _cosine_signed(normal: np.ndarray, way: np.ndarray) -> float:
    return float(normal @ way / (np.linalg.norm(normal) * np.linalg.norm(way)))


def cosine_between(normal: np.ndarray, way: np.ndarray) -> float:
    """Return the cosine between a normal and a direction, zero if the direction points behind the surface."""
    return min(max(_cosine_signed(normal, way), 0.0), 1.0)
