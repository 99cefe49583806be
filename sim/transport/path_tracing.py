"""Monte Carlo light budget on Mitsuba's own shapes and BSDFs: the hidden object's light, and all that comes another way.

Paths start at a random point of the frame. Towards a shape they aim at a disc that covers its bounding sphere, so that
variance stays low at -182 dB; every vertex is connected to a random point of the laser's spot, and the wall to a random point
of the pupil (next-event estimation; Veach, PhD thesis 1997, sections 8.3 and 9.2). Shares no geometry with the budget that
frames follow (`light_transport.py`): another sampling, the camera's rays instead of a pixel's footprint.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from radiometry.errors import InputError
from radiometry.photons import decibel
from sim.plugins.laser import Laser
from sim.plugins.speckle_camera import SpeckleCamera
from sim.transport.hidden_object import is_hidden_object
from sim.transport.surfaces import MOST_LAYERS, has_masks, is_one_of, reflected, transmittance

DEFAULT_SAMPLES = 2**20
BATCH = 2**20
BOUNCES = 4
"""Reflections between the laser's spot and the frame that light by other ways is followed for."""

MOST_AIMS = 16
"""Shapes that paths aim at; light by way of others is found by chance, at more variance."""

_NORMAL_95 = 1.959963985
_NEAR = 1.2
"""A shape nearer than this many radii of its bounding sphere is not aimed at."""


@dataclass(frozen=True)
class MonteCarlo:
    """Photoelectrons of a whole frame per laser photon, and the standard error of that mean."""

    per_frame: float
    standard_error: float
    samples: int

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of `per_frame`."""
        half = _NORMAL_95 * self.standard_error
        return max(self.per_frame - half, 0.0), self.per_frame + half

    @property
    def per_frame_db(self) -> float:
        return decibel(self.per_frame)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready; nothing arriving reads null."""
        decibels = [value if math.isfinite(value) else None for value in map(decibel, (self.per_frame, *self.interval))]
        return {"per_frame_db": decibels[0], "interval_db": decibels[1:], "samples": self.samples}


@dataclass(frozen=True)
class OtherLight:
    """Light that reaches the frame from the laser's spot, but not by one reflection off the hidden object.

    Attributes:
        total: of the whole frame.
        position: world places (n, 3) from which it last came, those of the paths that brought any.
        weight: photoelectrons of a frame per laser photon of each, (n,); they sum to the total.
    """

    total: MonteCarlo
    position: np.ndarray
    weight: np.ndarray


def estimate_throughput(scene: mi.Scene, samples: int = DEFAULT_SAMPLES, seed: int = 0,
                        camera: SpeckleCamera | None = None) -> MonteCarlo:
    """Estimate the light of the hidden object in a frame, of a loaded scene in the project's vocabulary.

    Raises InputError for too few samples.
    """
    return _mean(np.concatenate([_object_light(paths) for paths in _batches(scene, samples, seed, camera)]))


def estimate_other_light(scene: mi.Scene, samples: int = 2**16, seed: int = 0,
                         camera: SpeckleCamera | None = None) -> OtherLight:
    """Estimate the laser's light that reaches the frame by way of clutter or by several reflections.

    Light straight from the spot is left out; `Geometry.direct_light` tells of it. Raises InputError for too few samples.
    """
    values, positions = zip(*(_other_light(paths) for paths in _batches(scene, samples, seed, camera)), strict=True)
    total, position = np.concatenate(values), np.concatenate(positions)
    lit = total > 0.0
    return OtherLight(_mean(total), position[lit], total[lit] / len(total))


class _Paths:
    """Ends that all paths of a batch have: points of the frame, the pupil and the laser's spot."""

    def __init__(self, scene: mi.Scene, count: int, seed: int, camera: SpeckleCamera | None = None) -> None:
        self.scene, self.count = scene, count
        self.laser: Laser = next(emitter for emitter in scene.emitters() if isinstance(emitter, Laser))
        self.camera: SpeckleCamera = camera or next(sensor for sensor in scene.sensors() if isinstance(sensor, SpeckleCamera))
        self.masks = has_masks(scene)
        self._sampler = mi.PCG32(size=count, initstate=seed)
        camera, film = self.camera, self.camera.film().size()
        sides = (float(film[0]) * camera.pixel_pitch_m, float(film[1]) * camera.pixel_pitch_m)
        axis, up = (mi.Vector3f(*vector.tolist()) for vector in (camera.axis, camera.up))
        across, pupil = dr.cross(axis, up), mi.Point3f(*camera.pupil_centre.tolist())
        middle = scene.ray_intersect(mi.Ray3f(pupil, axis))
        place = self.uniform2()
        film_point = pupil + across * ((place.x - 0.5) * sides[0]) + up * ((place.y - 0.5) * sides[1])
        # Every pixel looks along the axis, from just before the wall: what stands nearer is found on the way to the pupil.
        before = dr.dot(middle.p - film_point, middle.n) / dr.dot(axis, middle.n) - 0.02 * middle.t
        self.wall = scene.ray_intersect(mi.Ray3f(film_point + axis * before, axis))
        self.lens = self.disc(pupil, axis, 0.5 * camera.pupil_diameter_m)
        beam = mi.Vector3f(*self.laser.direction.tolist())
        origin = self.disc(mi.Point3f(*self.laser.origin.tolist()), beam, 0.5 * self.laser.spot_diameter_m)
        self.spot = scene.ray_intersect(mi.Ray3f(origin, beam))
        self.spot.wi = self.spot.to_local(-beam)
        way = self.lens - self.wall.p
        lens_m = dr.norm(way)
        towards = way / lens_m
        self.wall.wi = self.wall.to_local(towards)
        named = {shape.id(): mi.ShapePtr(shape) for shape in scene.shapes()}
        self.active = self.wall.is_valid() & (self.wall.shape == named["virtual_detector"])
        self.active &= self.spot.is_valid() & (self.spot.shape == named["virtual_source"])
        # Radiance at the wall times this is photoelectrons of the frame.
        inclination = dr.abs(dr.dot(self.wall.n, axis))
        share = mi.Float64(sides[0] * sides[1] / inclination) * mi.Float64(dr.dot(self.wall.n, towards))
        share *= mi.Float64(-dr.dot(axis, towards)) * (0.25 * math.pi * camera.pupil_diameter_m**2) / dr.square(
            mi.Float64(lens_m))
        clear = transmittance(scene, self.wall, self.lens, self.active, masks=self.masks)
        self.collected = dr.select(self.active & (share > 0.0), share * mi.Float64(clear), 0.0) * (
            camera.transmission * camera.electronics.quantum_efficiency)

    def uniform(self) -> mi.Float:
        return self._sampler.next_float32()

    def uniform2(self) -> mi.Point2f:
        return mi.Point2f(self.uniform(), self.uniform())

    def disc(self, centre: mi.Point3f, axis: mi.Vector3f, radius: Any) -> mi.Point3f:
        """A random point of a disc."""
        frame, spread = mi.Frame3f(axis), self.uniform2()
        sine, cosine = dr.sincos(2.0 * np.pi * spread.x)
        reach = radius * dr.sqrt(spread.y)
        return centre + frame.s * (reach * cosine) + frame.t * (reach * sine)

    def hits(self, ray: mi.Ray3f, active: mi.Bool) -> Iterator[tuple[mi.SurfaceInteraction3f, mi.Float, mi.Bool]]:
        """Surfaces along a ray with the share of light that masks before them let through."""
        share = dr.select(active, mi.Float(1.0), 0.0)
        for _ in range(MOST_LAYERS if self.masks else 1):
            hit = self.scene.ray_intersect(ray, active)
            active = active & hit.is_valid()
            yield hit, share, active
            if self.masks:
                share = share * hit.bsdf().eval_null_transmission(hit, active)[0]
                active = active & (share > 0.0)
                ray = hit.spawn_ray(ray.d)

    def stopped(self, ray: mi.Ray3f, active: mi.Bool) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
        """The surface that stops a ray, and the chance that it did; masks let it pass by chance."""
        hit, through = self.scene.ray_intersect(ray, active), mi.Float(0.0)
        for _ in range(MOST_LAYERS if self.masks else 0):
            through = hit.bsdf().eval_null_transmission(hit, active & hit.is_valid())[0]
            passes = active & hit.is_valid() & (self.uniform() < through)
            hit = dr.select(passes, self.scene.ray_intersect(hit.spawn_ray(ray.d), passes), hit)
        if self.masks:
            through = hit.bsdf().eval_null_transmission(hit, active & hit.is_valid())[0]
        return hit, 1.0 - through

    def lit_by_spot(self, vertex: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Float64:
        """Radiance that leaves a vertex along its `wi` for light straight from a point of the spot, per laser photon."""
        way = self.spot.p - vertex.p
        distance = dr.norm(way)
        direction = way / distance
        emitted = reflected(self.spot, -direction, active)
        scattered = reflected(vertex, direction, active & (emitted > 0.0))
        lit = active & (scattered > 0.0)
        clear = transmittance(self.scene, vertex, self.spot.p, lit, masks=self.masks)
        radiance = mi.Float64(emitted) * mi.Float64(scattered * clear) / dr.square(mi.Float64(distance))
        return dr.select(lit, radiance, 0.0)


def _object_light(paths: _Paths) -> np.ndarray:
    """Light of the hidden object brought by each path of a batch."""
    aims = [_Aim(shape) for shape in paths.scene.shapes() if is_hidden_object(shape)]
    chances = np.array([aim.radius_m**2 for aim in aims])
    chances = np.cumsum(chances / chances.sum())
    pick, total = paths.uniform(), mi.Float64(0.0)
    start = paths.wall.p
    for index, aim in enumerate(aims):
        low = float(chances[index - 1]) if index else -1.0
        mine = paths.active & (pick > low) & (pick <= float(chances[index]))
        chance = float(chances[index]) - max(low, 0.0)
        direction, density = aim.sample(paths, start)
        imaged = reflected(paths.wall, direction, mine)
        mine &= imaged > 0.0
        for hit, share, seen in paths.hits(mi.Ray3f(start + 1e-4 * aim.distance(start) * direction, direction), mine):
            seen = seen & (hit.shape == mi.ShapePtr(aim.shape))
            hit.wi = hit.to_local(-direction)
            radiance = paths.lit_by_spot(hit, seen)
            total += dr.select(seen, radiance * mi.Float64(imaged * share) / (mi.Float64(density) * chance), 0.0)
    return np.asarray(total * paths.collected, np.float64)


def _other_light(paths: _Paths) -> tuple[np.ndarray, np.ndarray]:
    """Light by other ways that each path of a batch brought (n,), and the place that it came from last (n, 3)."""
    shapes = sorted(paths.scene.shapes(), key=lambda shape: not is_hidden_object(shape))
    aims = [_Aim(shape) for shape in shapes if shape.id() not in ("virtual_detector", "virtual_source")][:MOST_AIMS]
    vertex, active = paths.wall, mi.Bool(paths.active)
    weight, found, first = paths.collected, [], None
    for _ in range(BOUNCES):
        direction, density = _mixture(paths, aims, vertex)
        value = reflected(vertex, direction, active)
        active &= (value > 0.0) & (density > 0.0)
        weight = dr.select(active, weight * mi.Float64(value) / mi.Float64(density), 0.0)
        hit, stopping = paths.stopped(vertex.spawn_ray(direction), active)
        active &= hit.is_valid() & (stopping > 0.0)
        weight = dr.select(active, weight / mi.Float64(stopping), 0.0)
        hit.wi = hit.to_local(-direction)
        of_object = is_one_of(hit, [shape for shape in shapes if is_hidden_object(shape)])
        radiance = paths.lit_by_spot(hit, active)
        counts = active & ~of_object if first is None else active
        found.append(np.asarray(dr.select(counts, weight * radiance, 0.0), np.float64))
        first = np.asarray(hit.p, np.float64).T if first is None else first
        vertex = hit
    return np.stack(found, 1).sum(1), first


class _Aim:
    """The disc across the line of sight that covers a shape's bounding sphere."""

    def __init__(self, shape: mi.Shape) -> None:
        box = shape.bbox()
        low, high = np.asarray(box.min, np.float64), np.asarray(box.max, np.float64)
        self.shape, self.centre = shape, 0.5 * (low + high)
        self.radius_m = max(0.5 * float(np.linalg.norm(high - low)) * 1.001, 1e-9)

    def distance(self, start: mi.Point3f) -> mi.Float:
        return dr.norm(mi.Point3f(*self.centre.tolist()) - start)

    def disc_radius(self, distance: mi.Float) -> mi.Float:
        """Radius at the centre's distance of the cone that holds the sphere; 0 too near for one."""
        ratio = self.radius_m / distance
        far = ratio * _NEAR < 1.0
        return dr.select(far, self.radius_m / dr.sqrt(1.0 - dr.square(dr.select(far, ratio, 0.0))), 0.0)

    def sample(self, paths: _Paths, start: mi.Point3f) -> tuple[mi.Vector3f, mi.Float]:
        """A direction towards the disc, and its density per steradian."""
        distance = self.distance(start)
        centre = mi.Point3f(*self.centre.tolist())
        radius = self.disc_radius(distance)
        axis = (centre - start) / distance
        way = paths.disc(centre, axis, radius) - start
        direction = way / dr.norm(way)
        return direction, self.density(start, direction)

    def density(self, start: mi.Point3f, direction: mi.Vector3f) -> mi.Float:
        """Density of `sample` in a direction."""
        distance = self.distance(start)
        radius = self.disc_radius(distance)
        axis = mi.Vector3f(mi.Point3f(*self.centre.tolist()) - start) / distance
        cosine = dr.dot(direction, axis)
        off = dr.norm(dr.cross(direction, axis)) / cosine * distance
        inside = (cosine > 0.0) & (off <= radius * (1.0 + 1e-3)) & (radius > 0.0)
        return dr.select(inside, dr.square(distance) / (np.pi * dr.square(radius) * cosine**3), 0.0)


def _mixture(paths: _Paths, aims: list[_Aim], vertex: mi.SurfaceInteraction3f) -> tuple[mi.Vector3f, mi.Float]:
    """A direction from a vertex, half of the time by the cosine, else towards a shape; and the density of the mixture."""
    behind = dr.dot(vertex.n, vertex.to_world(vertex.wi)) < 0.0
    frame, spread = mi.Frame3f(dr.select(behind, -vertex.n, vertex.n)), paths.uniform2()
    sine, cosine = dr.sincos(2.0 * np.pi * spread.x)
    reach = dr.sqrt(spread.y)
    direction = frame.to_world(mi.Vector3f(reach * cosine, reach * sine, dr.sqrt(1.0 - spread.y)))
    share = 0.5 / max(len(aims), 1)
    pick = paths.uniform()
    for index, aim in enumerate(aims):
        chosen = (pick > 0.5 + index * share) & (pick <= 0.5 + (index + 1) * share)
        aimed, density = aim.sample(paths, vertex.p)
        direction = dr.select(chosen & (density > 0.0), aimed, direction)
    upwards = dr.dot(direction, frame.n)
    hemisphere = dr.select(upwards > 0.0, upwards / np.pi, 0.0)
    total = 0.5 * hemisphere if aims else hemisphere
    for aim in aims:
        near = aim.disc_radius(aim.distance(vertex.p)) <= 0.0
        total += share * dr.select(near, hemisphere, aim.density(vertex.p, direction))
    return direction, total


def _batches(scene: mi.Scene, samples: int, seed: int, camera: SpeckleCamera | None) -> Iterator[_Paths]:
    if samples < 2:
        raise InputError("samples", "at least 2", samples, "ask for more")
    for number, start in enumerate(range(0, samples, BATCH)):
        yield _Paths(scene, min(BATCH, samples - start), seed * 65537 + number, camera)


def _mean(values: np.ndarray) -> MonteCarlo:
    return MonteCarlo(float(values.mean()), float(values.std(ddof=1)) / math.sqrt(len(values)), len(values))
