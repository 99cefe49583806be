"""Surfaces that can be modelled: reflection as Mitsuba evaluates it; transmission, mirrors and media are refused by name."""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import mitsuba as mi

from correlograph.errors import InputError

MAX_LAYERS = 8
"""Maximum number of partly transparent surfaces (masks) along one ray."""

_TRANSMITTING = mi.BSDFFlags.DiffuseTransmission | mi.BSDFFlags.GlossyTransmission | mi.BSDFFlags.DeltaTransmission
_MIRROR = mi.BSDFFlags.DeltaReflection
ENERGY_TOLERANCE = 1e-3


def check_surfaces(scene: mi.Scene) -> None:
    """Raise InputError for a surface or medium that cannot be modelled."""
    for shape in scene.shapes():
        bsdf, name = shape.bsdf(), shape.id() or "shape"
        if shape.interior_medium() is not None or shape.exterior_medium() is not None:
            raise InputError(name, "surfaces in a vacuum", "a participating medium", "remove it; media are not modelled")
        if bsdf is None:
            continue
        if bsdf.flags() & int(_TRANSMITTING):
            raise InputError(
                name,
                "a surface that reflects",
                f"one that transmits light ({_kind(bsdf)})",
                "use an opaque BSDF, or a mask where there are holes; transmission is not modelled",
            )
        if bsdf.flags() & int(_MIRROR):
            raise InputError(
                name,
                "a rough surface",
                f"a mirror-like one ({_kind(bsdf)})",
                "give it a roughness (roughconductor, roughplastic); mirrors are not modelled",
            )


def _kind(bsdf: mi.BSDF) -> str:
    return str(bsdf).split("[")[0].strip()


def check_energy(name: str, hit: mi.SurfaceInteraction3f, lit: mi.Bool) -> None:
    """Raise InputError if a diffuse surface reflects more than it receives; `hit` lists points of it."""
    bsdf = hit.bsdf()
    diffuse = lit & ((bsdf.flags() & int(mi.BSDFFlags.Glossy)) == 0)
    albedo = float(dr.max(dr.select(diffuse, bsdf.eval_diffuse_reflectance(hit, diffuse)[0], 0.0))[0])
    if albedo > 1.0 + ENERGY_TOLERANCE:
        raise InputError(name, "an albedo of at most 1", f"{albedo:.4g}", "correct its reflectance")


def has_masks(scene: mi.Scene) -> bool:
    """Return whether any surface transmits a part of the light without deflection."""
    return any(shape.bsdf() is not None and mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null) for shape in scene.shapes())


def layers(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> Iterator[tuple[mi.SurfaceInteraction3f, mi.Bool]]:
    """Yield surfaces along a ray, nearest first, and whether there is one; those behind a partly transparent one follow it."""
    masks = has_masks(scene)
    for _ in range(MAX_LAYERS if masks else 1):
        hit = scene.ray_intersect(ray, active)
        active = active & hit.is_valid()
        yield hit, active
        if not masks:
            return
        active = active & (hit.bsdf().eval_null_transmission(hit, active)[0] > 0.0)
        if not dr.any(active)[0]:
            return
        ray = hit.spawn_ray(ray.d)


def is_one_of(hit: mi.SurfaceInteraction3f, shapes: list[mi.Shape]) -> mi.Bool:
    """Return whether a surface belongs to one of some shapes."""
    found = dr.zeros(mi.Bool, dr.width(hit.t))
    for shape in shapes:
        found |= hit.shape == mi.ShapePtr(shape)
    return found


def evaluate_bsdf(surface: mi.SurfaceInteraction3f, direction: mi.Vector3f, active: mi.Bool) -> mi.Float:
    """Return BSDF times cosine for light along `surface.wi` and `direction`, both away from the surface."""
    return surface.bsdf().eval(mi.BSDFContext(), surface, surface.to_local(direction), active)[0]


def transmittance(
    scene: mi.Scene, start: mi.SurfaceInteraction3f | mi.Point3f, end: mi.Point3f, active: mi.Bool, *, masks: bool
) -> mi.Float:
    """Return the fraction of the light that passes between two points; 0 behind an opaque shape.

    Args:
        start: a point of a surface, or in space. end: a point of a surface; the path is shortened by 1e-4 of the distance against
            self-occlusion.
        masks: whether the scene has any mask; if not, one shadow ray suffices.
    """
    if isinstance(start, mi.SurfaceInteraction3f):
        ray = _towards(start.spawn_ray(end - start.p).o, end)
    else:
        ray = _towards(start + 1e-4 * (end - start), end)
    if not masks:
        return dr.select(active & ~scene.ray_test(ray, active), mi.Float(1.0), 0.0)
    share, going = dr.select(active, mi.Float(1.0), 0.0), mi.Bool(active)
    for _ in range(MAX_LAYERS):
        hit = scene.ray_intersect(ray, going)
        going &= hit.is_valid()
        share = dr.select(going, share * hit.bsdf().eval_null_transmission(hit, going)[0], share)
        going &= share > 0.0
        ray = _towards(hit.spawn_ray(ray.d).o, end)  # it starts slightly off the surface
    return dr.select(going & scene.ray_test(ray, going), 0.0, share)


def _towards(start: mi.Point3f, end: mi.Point3f) -> mi.Ray3f:
    """Return the ray from one point to just before another."""
    way = end - start
    distance = dr.norm(way)
    ray = mi.Ray3f(start, way / distance)
    ray.maxt = distance * (1.0 - 1e-4)
    return ray
