"""Ends of the paths of the Monte Carlo light budget, and the shapes that they aim at."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from sim.plugins.laser import Laser
from sim.plugins.speckle_camera import SpeckleCamera
from sim.transport.surfaces import MAX_LAYERS, evaluate_bsdf, has_masks, transmittance

_NEAR = 1.2
"""Minimum distance of a target shape in radii of its bounding sphere."""


class PathEnds:
    """Ends of all paths of a batch: points of the frame, the pupil and the laser spot."""

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
        self.frame_centre = middle.p
        place = self.uniform2()
        film_point = pupil + across * ((place.x - 0.5) * sides[0]) + up * ((place.y - 0.5) * sides[1])
        # Every pixel looks along the axis from just before the wall; nearer shapes are found on the way to the pupil.
        before = dr.dot(middle.p - film_point, middle.n) / dr.dot(axis, middle.n) - 0.02 * middle.t
        self.wall = scene.ray_intersect(mi.Ray3f(film_point + axis * before, axis))
        self.lens = self.disc(pupil, axis, 0.5 * camera.pupil_diameter_m)
        beam = mi.Vector3f(*self.laser.direction.tolist())
        origin = self.disc(mi.Point3f(*self.laser.origin.tolist()), beam, 0.5 * self.laser.spot_diameter_m)
        self.spot = scene.ray_intersect(mi.Ray3f(origin, beam))
        self.spot_centre = scene.ray_intersect(mi.Ray3f(mi.Point3f(*self.laser.origin.tolist()), beam)).p
        self.spot.wi = self.spot.to_local(-beam)
        way = self.lens - self.wall.p
        lens_m = dr.norm(way)
        towards = way / lens_m
        self.wall.wi = self.wall.to_local(towards)
        named = {shape.id(): mi.ShapePtr(shape) for shape in scene.shapes()}
        self.active = self.wall.is_valid() & (self.wall.shape == named["virtual_detector"])
        self.active &= self.spot.is_valid() & (self.spot.shape == named["virtual_source"])
        # Radiance at the wall times this factor is photoelectrons of the frame.
        inclination = dr.abs(dr.dot(self.wall.n, axis))
        share = mi.Float64(sides[0] * sides[1] / inclination) * mi.Float64(dr.dot(self.wall.n, towards))
        share *= (
            mi.Float64(-dr.dot(axis, towards)) * (0.25 * math.pi * camera.pupil_diameter_m**2) / dr.square(mi.Float64(lens_m))
        )
        clear = transmittance(scene, self.wall, self.lens, self.active, masks=self.masks)
        self.collected = dr.select(self.active & (share > 0.0), share * mi.Float64(clear), 0.0) * (
            camera.transmission * camera.electronics.quantum_efficiency
        )

    def uniform(self) -> mi.Float:
        return self._sampler.next_float32()

    def uniform2(self) -> mi.Point2f:
        return mi.Point2f(self.uniform(), self.uniform())

    def disc(self, centre: mi.Point3f, axis: mi.Vector3f, radius: Any) -> mi.Point3f:
        """Sample a random point of a disc."""
        frame, spread = mi.Frame3f(axis), self.uniform2()
        sine, cosine = dr.sincos(2.0 * np.pi * spread.x)
        reach = radius * dr.sqrt(spread.y)
        return centre + frame.s * (reach * cosine) + frame.t * (reach * sine)

    def hits(self, ray: mi.Ray3f, active: mi.Bool) -> Iterator[tuple[mi.SurfaceInteraction3f, mi.Float, mi.Bool]]:
        """Yield the surfaces along a ray with the fraction of light that masks before them transmit."""
        share = dr.select(active, mi.Float(1.0), 0.0)
        for _ in range(MAX_LAYERS if self.masks else 1):
            hit = self.scene.ray_intersect(ray, active)
            active = active & hit.is_valid()
            yield hit, share, active
            if self.masks:
                share = share * hit.bsdf().eval_null_transmission(hit, active)[0]
                active = active & (share > 0.0)
                ray = hit.spawn_ray(ray.d)

    def find_obstruction(self, ray: mi.Ray3f, active: mi.Bool) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
        """Return the surface that stops a ray, and its probability of doing so; masks transmit at random."""
        hit, through = self.scene.ray_intersect(ray, active), mi.Float(0.0)
        for _ in range(MAX_LAYERS if self.masks else 0):
            through = hit.bsdf().eval_null_transmission(hit, active & hit.is_valid())[0]
            passes = active & hit.is_valid() & (self.uniform() < through)
            hit = dr.select(passes, self.scene.ray_intersect(hit.spawn_ray(ray.d), passes), hit)
        if self.masks:
            through = hit.bsdf().eval_null_transmission(hit, active & hit.is_valid())[0]
        return hit, 1.0 - through

    def lit_by_spot(self, vertex: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Float64:
        """Return the radiance that leaves a surface point towards the camera (its `wi`), lit by a random point of the laser
        spot, per laser photon."""
        way = self.spot.p - vertex.p
        distance = dr.norm(way)
        direction = way / distance
        emitted = evaluate_bsdf(self.spot, -direction, active)
        scattered = evaluate_bsdf(vertex, direction, active & (emitted > 0.0))
        lit = active & (scattered > 0.0)
        clear = transmittance(self.scene, vertex, self.spot.p, lit, masks=self.masks)
        radiance = mi.Float64(emitted) * mi.Float64(scattered * clear) / dr.square(mi.Float64(distance))
        return dr.select(lit, radiance, 0.0)


class Aim:
    """Disc across the line of sight that covers the bounding sphere of a shape."""

    def __init__(self, shape: mi.Shape) -> None:
        box = shape.bbox()
        low, high = np.asarray(box.min, np.float64), np.asarray(box.max, np.float64)
        self.shape, self.centre = shape, 0.5 * (low + high)
        self.radius_m = max(0.5 * float(np.linalg.norm(high - low)) * 1.001, 1e-9)

    def distance(self, start: mi.Point3f) -> mi.Float:
        return dr.norm(mi.Point3f(*self.centre.tolist()) - start)

    def disc_radius(self, distance: mi.Float) -> mi.Float:
        """Return the radius of the disc, through the centre of the shape's bounding sphere, that covers the sphere as seen
        from a distance; 0 within 1.2 radii of the sphere.
        """
        ratio = self.radius_m / distance
        far = ratio * _NEAR < 1.0
        return dr.select(far, self.radius_m / dr.sqrt(1.0 - dr.square(dr.select(far, ratio, 0.0))), 0.0)

    def sample(self, paths: PathEnds, start: mi.Point3f) -> tuple[mi.Vector3f, mi.Float]:
        """Sample a direction towards the disc, with its density per steradian."""
        distance = self.distance(start)
        centre = mi.Point3f(*self.centre.tolist())
        radius = self.disc_radius(distance)
        axis = (centre - start) / distance
        way = paths.disc(centre, axis, radius) - start
        direction = way / dr.norm(way)
        return direction, self.density(start, direction)

    def density(self, start: mi.Point3f, direction: mi.Vector3f) -> mi.Float:
        """Return the density of `sample` in a direction."""
        distance = self.distance(start)
        radius = self.disc_radius(distance)
        axis = mi.Vector3f(mi.Point3f(*self.centre.tolist()) - start) / distance
        cosine = dr.dot(direction, axis)
        off = dr.norm(dr.cross(direction, axis)) / cosine * distance
        inside = (cosine > 0.0) & (off <= radius * (1.0 + 1e-3)) & (radius > 0.0)
        return dr.select(inside, dr.square(distance) / (np.pi * dr.square(radius) * cosine**3), 0.0)


def mixture(paths: PathEnds, aims: list[Aim], vertex: mi.SurfaceInteraction3f) -> tuple[mi.Vector3f, mi.Float]:
    """Sample a direction from a vertex, with probability 1/2 by the cosine, otherwise towards a shape, and its probability
    density per steradian.
    """
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
