"""Scene -> Geometry: where the light goes, in float64, checked at the door."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from radiometry.autocorrelation import SIDE
from radiometry.errors import InputError
from radiometry.motion import Motion
from radiometry.photons import photon_rate
from radiometry.throughput import LightPath, closed_form, detector_to_pixel
from sim.plugins.laser import Laser
from sim.plugins.phase_screen import PhaseScreen
from sim.plugins.speckle_camera import Electronics, SpeckleCamera
from sim.propagation.sampling import canvas, period
from sim.transport.ambient import ambient_irradiance
from sim.transport.detector_texture import detector_albedo, texture_of
from sim.transport.footprint import GRAZING, lag_axes, pixel_steps
from sim.transport.hidden_object import FlatObject, HiddenObject, bounds, is_hidden_object
from sim.transport.light_transport import LightTransport
from sim.transport.path_tracing import OtherLight, estimate_other_light
from sim.transport.surfaces import check_energy, check_surfaces
from sim.variant import check_compilable


@dataclass(frozen=True)
class Spot:
    """Laser spot on the virtual source: a uniform disc on a rough wall."""

    centre: np.ndarray
    diameter_m: float
    height_rms_m: float
    correlation_length_m: float
    scan_step_m: float | None
    """Way of the spot between frames; None for at least its diameter."""
    scan_speed_m_s: float
    """Speed of the spot over the wall while the shutter is open."""
    beam: np.ndarray
    """Direction of the laser's light."""
    normal: np.ndarray
    """Of the wall, towards the light."""


@dataclass(frozen=True)
class Geometry:
    """What the simulator needs to know of a scene. Lengths in metres, vectors in world axes (3,).

    `right` and `down` are the steps on the wall from a pixel to the next, per metre of `pixel_pitch_m`, as the camera sees
    them: longer than 1 along the turn of a camera that looks at the wall at an angle.
    """

    spot: Spot
    hidden_object: HiddenObject | FlatObject
    detector_centre: np.ndarray
    pupil_centre: np.ndarray
    right: np.ndarray
    down: np.ndarray
    frame_shape: tuple[int, int]
    pixel_pitch_m: float
    pupil_diameter_m: float
    pupil_distance_m: float
    electronics: Electronics
    light_path: LightPath
    baffled: bool
    """Whether a shape stands on the straight line from the virtual source to the virtual detector."""
    direct_light: float
    """Fraction of the laser's light that one square metre of the virtual detector receives straight
    from the virtual source: zero when a baffle, or the walls' own facing, blocks it."""
    linewidth_hz: float
    depolarised: bool
    """Whether light has lost its polarisation before it reaches the virtual detector."""
    detector_height_rms_m: float | None
    """Roughness of the virtual detector; None where no phase_screen tells it."""
    detector_texture: np.ndarray | None
    """Albedo of the virtual detector under each pixel over its mean, float32 (H, W); None where it is the same everywhere."""
    ambient_irradiance: np.ndarray | None
    """Light of other emitters on the frame in W/m^2, a coarse map (see `ambient.py`); None without any."""
    object_velocity_m_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Of the hidden object, in world axes (3,)."""
    frame_interval_s: float = 0.0
    """From the beginning of one frame to that of the next; the exposure where it is shorter."""
    other_light: OtherLight | None = None
    """The laser's light by way of clutter or of several reflections; None for an object shown in place of the scene's."""

    def exposed(self, exposure_s: float) -> Geometry:
        """The same scene at another exposure."""
        return replace(self, electronics=replace(self.electronics, exposure_s=exposure_s))

    def showing(self, cells: np.ndarray, pitch_m: float | tuple[float, float]) -> Geometry:
        """The same scene with a flat object of albedo cells (n, n) in place of its own, `pitch_m` apart (down, right)."""
        pitches = pitch_m if isinstance(pitch_m, tuple) else (pitch_m, pitch_m)
        shown = FlatObject(cells, pitches, self.hidden_object)
        path = replace(self.light_path, object_albedo_area_m2=shown.albedo_area_m2(), beyond_flat=1.0)
        return replace(self, hidden_object=shown, light_path=path, other_light=None)

    @property
    def wavelength_m(self) -> float:
        return self.light_path.wavelength_m

    @property
    def source_distance_m(self) -> float:
        return self.light_path.source_to_object_m

    @property
    def distance_m(self) -> float:
        """Object to virtual detector."""
        return self.light_path.object_to_detector_m

    @property
    def other_light_share(self) -> float:
        """The laser's light by other ways over the hidden object's."""
        if self.other_light is None or self.hidden_object.throughput == 0.0:
            return 0.0
        return self.other_light.total.per_frame / (self.hidden_object.throughput * self.light_path.pixels)

    @property
    def ambient_photoelectrons_per_pixel_s(self) -> np.ndarray | None:
        """Photoelectrons of ambient light, a coarse map over the frame; None without any."""
        if self.ambient_irradiance is None:
            return None
        path = self.light_path
        photons = photon_rate(1.0, path.wavelength_m) * path.pixel_area_m2
        return self.ambient_irradiance * photons * detector_to_pixel(path)

    @property
    def object_speed_m_s(self) -> tuple[float, float]:
        """Across the line of sight along the object's axes (down, right)."""
        down, right = self.hidden_object.axes.coordinates(self.object_velocity_m_s)
        return float(down), float(right)

    @property
    def motion(self) -> Motion:
        """What moves during one exposure."""
        exposure_s, (down, right) = self.electronics.exposure_s, self.object_speed_m_s
        return Motion(self.spot.scan_speed_m_s * exposure_s / self.spot.diameter_m, (down * exposure_s, right * exposure_s),
                      self.wavelength_m * self.source_distance_m / self.spot.diameter_m,
                      (1.0 / self.source_distance_m + 1.0 / self.distance_m) / self.wavelength_m)

    @property
    def seen_pitch_m(self) -> tuple[float, float]:
        """Distance of neighbouring rows and columns as the object sees them: a lag is lambda z over pixels times this."""
        stretch = self.hidden_object.axes.stretch
        return self.pixel_pitch_m / stretch[0], self.pixel_pitch_m / stretch[1]

    @property
    def seen_pixel_area_m2(self) -> float:
        """Area of a pixel's footprint across the line of sight."""
        step_down, step_right = self.hidden_object.axes.step
        return self.pixel_pitch_m**2 * float(np.linalg.norm(np.cross(step_down, step_right)))

    @property
    def canvas_shape(self) -> tuple[int, int]:
        """Pixels (rows, columns) of which the field is computed: the frame and a border for the camera's blur."""
        return canvas(self.frame_shape)

    @property
    def period_shape(self) -> tuple[int, int]:
        """Pixels after which the field of samples at `object_pitch_m` repeats."""
        grains = [self.wavelength_m * self.distance_m / (extent * pitch)
                  for extent, pitch in zip(self.hidden_object.extent_m, self.seen_pitch_m, strict=True)]
        return period(self.canvas_shape, (grains[0], grains[1]))

    @property
    def object_pitch_m(self) -> tuple[float, float]:
        """Object sampling (down, right) whose FFT is exactly a period: lambda z / (pixels pitch)."""
        rows, columns = (self.wavelength_m * self.distance_m / (n * pitch)
                         for n, pitch in zip(self.period_shape, self.seen_pitch_m, strict=True))
        return rows, columns


def fingerprint(scene: mi.Scene) -> int:
    """A number that changes when `mi.traverse` changes anything in a scene."""
    return hash(tuple((key, np.asarray(value).tobytes() if hasattr(value, "__array__") or dr.is_array_v(value) else str(value))
                      for key, value in mi.traverse(scene).items()))


def read_geometry(scene: mi.Scene, sensor: SpeckleCamera | None = None) -> Geometry:
    """Read a scene in the project's vocabulary; raises InputError naming what is missing or impossible.

    Args:
        sensor: the camera to look through; the scene's only speckle_camera where None.
    """
    check_compilable(scene)
    check_surfaces(scene)
    shapes = {shape.id(): shape for shape in scene.shapes()}
    # A shape of a scene file is never a plain, nameless Mesh; what Mitsuba merges is.
    if any(shape.class_name() == "Mesh" and not shape.id() for shape in scene.shapes()):
        raise InputError("scene", "every shape apart, with its id", "shapes merged by Mitsuba",
                         "pass optimize=False to mi.load_file")
    source = _shape(shapes, "virtual_source")
    detector = _shape(shapes, "virtual_detector")
    laser = _only(scene.emitters(), Laser, "laser")
    camera = sensor if isinstance(sensor, SpeckleCamera) else _only(scene.sensors(), SpeckleCamera, "speckle_camera")
    hidden_shapes = [shape for shape in scene.shapes() if is_hidden_object(shape)]
    if not hidden_shapes:
        raise InputError("hidden_object", "at least one shape whose id starts with hidden_object", sorted(shapes),
                         "add one, and pass optimize=False to mi.load_file")

    spot_point, source_normal, source_albedo = _first_hit(scene, laser.origin, laser.direction, source, "the laser beam")
    detector_centre, detector_normal, _ = _first_hit(scene, camera.pupil_centre, camera.axis, detector,
                                                     "the axis of the speckle_camera")
    height, width = _film_size(camera)
    _check_spot_fits(scene, laser, source)
    right, down = pixel_steps(camera.axis, camera.up, _facing(detector_normal, camera.axis, "the speckle_camera"))
    wall_albedo, texture = texture_of(detector_albedo(scene, detector, camera, detector_centre, right, down, (height, width)))

    centre = 0.5 * np.sum(bounds(hidden_shapes), axis=0)
    line = _unit(centre - detector_centre)
    _facing(detector_normal, line, "the hidden_object")
    transport = LightTransport(scene, laser, camera, detector_centre, right, down, (height, width), wall_albedo)
    hidden_object = HiddenObject(transport, centre, lag_axes(right, down, line))
    cosines = hidden_object.mean_cosines()
    to_source, to_detector = hidden_object.centre - spot_point, detector_centre - hidden_object.centre
    to_pupil = camera.pupil_centre - detector_centre
    screen = source.bsdf()
    if not isinstance(screen, PhaseScreen):
        raise InputError("virtual_source", "a phase_screen BSDF", type(screen).__name__, "wrap its BSDF in a phase_screen")
    path = LightPath(
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
        pixel_area_m2=camera.pixel_pitch_m**2 * float(np.linalg.norm(np.cross(right, down))),
        pixels=height * width,
    )
    flat = closed_form(path).per_pixel
    if flat > 0.0 and hidden_object.throughput > 0.0:
        path = replace(path, beyond_flat=hidden_object.throughput / flat)
    return Geometry(
        spot=Spot(spot_point, laser.spot_diameter_m, screen.height_rms_m, screen.correlation_length_m, laser.scan_step_m,
                  laser.scan_speed_m_s, laser.direction, source_normal),
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
        baffled=is_blocked(scene, spot_point, detector_centre),
        linewidth_hz=laser.linewidth_hz,
        depolarised=any(isinstance(shape.bsdf(), PhaseScreen) and shape.bsdf().depolarising for shape in scene.shapes()
                        if shape.id() == "virtual_source" or is_hidden_object(shape)),
        detector_height_rms_m=detector.bsdf().height_rms_m if isinstance(detector.bsdf(), PhaseScreen) else None,
        detector_texture=texture,
        ambient_irradiance=ambient_irradiance(scene, detector_centre, right, down, detector_normal,
                                              (height * camera.pixel_pitch_m, width * camera.pixel_pitch_m)),
        object_velocity_m_s=_velocity(hidden_shapes),
        frame_interval_s=camera.frame_interval_s,
        other_light=estimate_other_light(scene, camera=camera),
        direct_light=_direct_light(scene, path.source_albedo, spot_point, source_normal, detector_centre, detector_normal),
    )


def _shape(shapes: dict[str, mi.Shape], name: str) -> mi.Shape:
    if name not in shapes:
        raise InputError(name, f"a shape with id {name}", f"only {sorted(shapes)}",
                         "add it, and pass optimize=False to mi.load_file")
    return shapes[name]


def _only(plugins: list, kind: type, name: str):
    found = [plugin for plugin in plugins if isinstance(plugin, kind)]
    if len(found) != 1:
        raise InputError(name, f"exactly one {name} in the scene", len(found), "add or remove one")
    return found[0]


def _first_hit(scene: mi.Scene, origin: np.ndarray, direction: np.ndarray, expected: mi.Shape,
               ray_name: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Point, outward normal and diffuse albedo where a ray first meets the scene, which must be `expected`."""
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(*origin.tolist()), mi.Vector3f(*direction.tolist())))
    if not bool(hit.is_valid()[0]):
        raise InputError(expected.id(), f"{ray_name} to meet it", "nothing there", "correct the to_world transforms")
    if hit.shape[0] != expected:
        raise InputError(expected.id(), f"{ray_name} to meet it", f"{hit.shape[0].id()} in the way",
                         "move one of them")
    distance = float(hit.t[0])
    check_energy(expected.id(), hit, hit.is_valid())
    normal = np.asarray(hit.n, np.float64).reshape(3)
    albedo = float(np.asarray(hit.bsdf().eval_diffuse_reflectance(hit)).reshape(-1)[0])
    if normal @ direction > 0.0:
        raise InputError(expected.id(), f"{ray_name} to meet its front", "its back", "turn the shape round")
    return origin + distance * direction, _unit(normal), albedo


def _film_size(camera: SpeckleCamera) -> tuple[int, int]:
    """Rows and columns of the film, which must not be cropped and must hold one patch of all lags."""
    film = camera.film()
    height, width = int(film.size()[1]), int(film.size()[0])
    if [int(n) for n in film.crop_size()] != [width, height]:
        raise InputError("film", "the whole film", f"a crop of {film.crop_size()}", "set width and height instead")
    if min(height, width) < SIDE:
        raise InputError("film", f"at least {SIDE} x {SIDE} pixels (one patch)", f"{width} x {height}", "enlarge it")
    return height, width


def _check_spot_fits(scene: mi.Scene, laser: Laser, source: mi.Shape) -> None:
    """The whole beam must land on the virtual source."""
    across = _unit(np.cross(laser.direction, [0.577, 0.211, 0.789]))
    up = np.cross(laser.direction, across)
    for turn in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
        edge = laser.origin + 0.5 * laser.spot_diameter_m * (np.cos(turn) * across + np.sin(turn) * up)
        _first_hit(scene, edge, laser.direction, source, "the edge of the laser beam")


def _direct_light(scene: mi.Scene, source_albedo: float, spot: np.ndarray, source_normal: np.ndarray,
                  detector: np.ndarray, detector_normal: np.ndarray) -> float:
    way = detector - spot
    cosines = max(_cosine_signed(source_normal, way), 0.0) * max(_cosine_signed(detector_normal, -way), 0.0)
    if cosines == 0.0 or is_blocked(scene, spot, detector):
        return 0.0
    return source_albedo * cosines / (np.pi * float(way @ way))


def _velocity(shapes: list[mi.Shape]) -> np.ndarray:
    """Of the hidden object as a whole; InputError where its parts move apart."""
    found = np.array([shape.bsdf().velocity_m_s if isinstance(shape.bsdf(), PhaseScreen) else np.zeros(3) for shape in shapes])
    if np.ptp(found, axis=0).any():
        raise InputError("hidden_object", "one velocity for all of its shapes", found.tolist(), "correct their phase_screens")
    return found[0]


def _facing(normal: np.ndarray, direction: np.ndarray, name: str) -> np.ndarray:
    """The wall's normal, if what looks at it along `direction` does so at less than 87 degrees."""
    cosine = abs(float(normal @ direction))
    if cosine < GRAZING:
        raise InputError("virtual_detector", f"{name} at most {np.degrees(np.arccos(GRAZING)):.0f} degrees off its normal",
                         f"{np.degrees(np.arccos(cosine)):.1f} degrees", "turn one of them")
    return normal


def is_blocked(scene: mi.Scene, start: np.ndarray, end: np.ndarray) -> bool:
    """Whether a shape stands between two points, both end points' own surfaces left out."""
    way = end - start
    ray = mi.Ray3f(mi.Point3f(*(start + 1e-4 * way).tolist()), mi.Vector3f(*_unit(way).tolist()))
    ray.maxt = float(np.linalg.norm(way)) * (1.0 - 2e-4)
    return bool(scene.ray_test(ray)[0])


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _cosine_signed(normal: np.ndarray, way: np.ndarray) -> float:
    return float(normal @ way / (np.linalg.norm(normal) * np.linalg.norm(way)))


def _cosine(normal: np.ndarray, way: np.ndarray) -> float:
    """Cosine between a normal and a way out, zero where the way lies behind the surface."""
    return min(max(_cosine_signed(normal, way), 0.0), 1.0)
