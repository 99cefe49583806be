"""Ambient light: irradiance of the virtual detector by emitters other than the laser, by a small path tracer.

Next-event estimation at every vertex and cosine-weighted reflections; all surfaces count as Lambertian with their diffuse
reflectance. Mitsuba supplies rays, emitters and textures. (Mitsuba's own path integrator needs a newer libLLVM than many systems
have.)
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from sim.camera_view import CameraView
from sim.plugins.laser import Laser

GRID = 8
"""Cells along a side of the frame in which the irradiance is estimated."""

SAMPLES = 4096
"""Paths per cell."""

BOUNCES = 4


def ambient_irradiance(scene: mi.Scene, view: CameraView, normal: np.ndarray) -> np.ndarray | None:
    """Return the irradiance in W/m^2, by emitters other than the laser and within the filter band, of the imaged part of the wall.

    The result is float64 (GRID, GRID), or None if there is no such emitter.

    Args:
        normal: normal of the wall.
    """
    if not any(not isinstance(emitter, Laser) for emitter in scene.emitters()):
        return None
    sampler = mi.PCG32(size=GRID * GRID * SAMPLES, initstate=7)
    cell = dr.arange(mi.UInt, GRID * GRID * SAMPLES) // SAMPLES
    row = (mi.Float(cell // GRID) + sampler.next_float32()) / GRID - 0.5
    column = (mi.Float(cell % GRID) + sampler.next_float32()) / GRID - 0.5
    place = (
        mi.Point3f(*view.centre.tolist())
        + row * view.extent_m[0] * mi.Vector3f(*view.down.tolist())
        + column * view.extent_m[1] * mi.Vector3f(*view.right.tolist())
    )
    facing = mi.Vector3f(*normal.tolist())
    weight, total, alive = mi.Float(np.pi), mi.Float(0.0), mi.Bool(True)
    for bounce in range(BOUNCES):
        vertex = dr.zeros(mi.Interaction3f, dr.width(cell))
        vertex.p, vertex.n = place, facing
        vertex.t = mi.Float(0.0)
        towards, radiance = scene.sample_emitter_direction(
            vertex, mi.Point2f(sampler.next_float32(), sampler.next_float32()), True, alive
        )
        cosine = dr.dot(facing, towards.d)
        total += dr.select(alive & (cosine > 0.0) & (towards.pdf > 0.0), weight * cosine * radiance[0] / np.pi, 0.0)
        if bounce == BOUNCES - 1:
            break
        # Mitsuba's own cosine warp compiles to an instruction that libLLVM before 17 lacks.
        share, (sine, cosine) = sampler.next_float32(), dr.sincos(2.0 * dr.pi * sampler.next_float32())
        radius = dr.sqrt(share)
        direction = mi.Frame3f(facing).to_world(mi.Vector3f(radius * cosine, radius * sine, dr.sqrt(1.0 - share)))
        ray = mi.Ray3f(place + 1e-5 * facing, direction)
        hit = scene.ray_intersect(ray, alive)
        front = dr.dot(hit.n, direction) < 0.0
        alive &= hit.is_valid() & front
        weight *= dr.select(alive, hit.bsdf().eval_diffuse_reflectance(hit, alive)[0], 0.0)
        place, facing = hit.p, mi.Vector3f(hit.n)
    return np.asarray(total, np.float64).reshape(GRID, GRID, SAMPLES).mean(2)
