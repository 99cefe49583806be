"""Light from the laser by a surface to a pixel, one point of the surface at a time.

The three reflections are Mitsuba's own BSDFs, evaluated for the true directions and distances; every path segment is tested for
occluders. A point x of the surface that fills the solid angle w of the frame centre carries

    w f_s cos_s / |x - s|^2  f_x cos_x  f_d cos_d / |p - d|^2 cos_p  A_pixel cos A_pupil

photoelectrons per laser photon into a pixel, times transmission and quantum efficiency (the three reflections of Metzler et al.
2020, section 6.B, without approximation). The points s of the laser spot, d of the frame and p of the pupil follow a quasi-random
sequence (R_d: Roberts, extremelearning.com.au/unreasonable-effectiveness-of-quasirandom-sequences), so that a sum over many points
x also averages over spot, frame and pupil.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from sim.camera_view import CameraView
from sim.plugins.laser import Laser
from sim.plugins.speckle_camera import SpeckleCamera
from sim.transport.surfaces import evaluate_bsdf, has_masks, transmittance

_GOLDEN_6 = 1.1127756842787055
"""Root of x^7 = x + 1; the sequence in six dimensions steps by its negative powers."""

_RUN = 64


@dataclass(frozen=True)
class CarriedLight:
    """Light carried by points of a surface, (n,) each; 0 for a hidden or dark point.

    Attributes:
        radiance: photoelectrons in a pixel per laser photon and per steradian of solid angle at the start of the rays.
        albedo: pi times the BSDF: the albedo of a Lambertian surface of equal brightness.
        cosine_in, cosine_out: towards the spot and the frame.
    """

    radiance: np.ndarray
    albedo: np.ndarray
    cosine_in: np.ndarray
    cosine_out: np.ndarray


@dataclass(frozen=True)
class LightTransport:
    """Fixed ends of every light path of a scene.

    Attributes:
        wall_albedo: mean albedo of the frame.
        most_foreshortened: maximum `foreshortening` up to which rays from the frame centre represent a pixel.
    """

    scene: mi.Scene
    laser: Laser
    camera: SpeckleCamera
    view: CameraView
    wall_albedo: float
    most_foreshortened: float = 4.0

    @property
    def frame_reach_m(self) -> float:
        """Distance of the farthest corner of the frame from its centre."""
        height, width = (0.5 * n for n in self.view.extent_m)
        return max(float(np.linalg.norm(height * self.view.down + side * width * self.view.right)) for side in (-1.0, 1.0))

    def frame_points(self, count: int) -> mi.Point3f:
        """Return `count` points of the frame, which `compute_carried_light` pairs one by one with `count` surface points."""
        return self._wall(_spread(count)[1])[0].p

    def foreshortening(self, hit: mi.SurfaceInteraction3f, place: mi.Point3f) -> mi.Float:
        """Return the solid angle of a surface as seen from another point of the frame in units of that from its centre;
        negative if they see two sides of it."""
        way, centre = place - hit.p, mi.Point3f(*self.view.centre.tolist()) - hit.p
        cosines = dr.dot(hit.n, way) / dr.dot(hit.n, centre)
        return cosines * (dr.norm(centre) / dr.norm(way)) ** 3

    def compute_carried_light(self, hit: mi.SurfaceInteraction3f, active: mi.Bool, *, from_centre: bool = True) -> CarriedLight:
        """Return the light carried by points of a surface.

        Args:
            hit: surface points met by rays from the frame centre or, without `from_centre`, from `frame_points`.
        """
        masks = has_masks(self.scene)
        spot, pixel, pupil = _spread(dr.width(hit.p))
        source, on_source = self._source(spot)
        wall, on_wall = self._wall(pixel)
        lens = self._pupil(pupil)
        active = active & on_source & on_wall

        def towards(start: mi.Point3f, end: mi.Point3f) -> tuple[mi.Vector3f, mi.Float]:
            way = end - start
            distance = dr.norm(way)
            return way / distance, distance

        to_source, source_m = towards(hit.p, source.p)
        to_wall, _ = towards(hit.p, wall.p)
        to_lens, lens_m = towards(wall.p, lens)

        source.wi = source.to_local(-mi.Vector3f(*self.laser.direction.tolist()))
        emitted = evaluate_bsdf(source, -to_source, active)
        hit.wi = hit.to_local(to_wall)
        scattered = evaluate_bsdf(hit, to_source, active & (emitted > 0.0))
        wall.wi = wall.to_local(to_lens)
        imaged = evaluate_bsdf(wall, -to_wall, active & (scattered > 0.0))
        albedo = wall.bsdf().eval_diffuse_reflectance(wall, on_wall)[0]
        # The texture of the frame is a separate effect: here every pixel has the mean albedo.
        painted = float(dr.mean(dr.select(on_wall & (albedo > 0.0), mi.Float(1.0), 0.0))[0])
        textured = dr.select(albedo > 0.0, imaged / albedo * (self.wall_albedo / max(painted, 1e-9)), 0.0)

        cosine_in, cosine_out = dr.abs(dr.dot(hit.n, to_source)), dr.abs(dr.dot(hit.n, to_wall))
        foreshortened = self.foreshortening(hit, wall.p) if from_centre else mi.Float(1.0)
        lit = active & (textured > 0.0) & (foreshortened > 0.0) & (foreshortened <= self.most_foreshortened)
        clear = transmittance(self.scene, hit, source.p, lit, masks=masks)
        clear *= transmittance(self.scene, hit, wall.p, lit & (clear > 0.0), masks=masks)
        clear *= transmittance(self.scene, wall, lens, lit & (clear > 0.0), masks=masks)
        axis = mi.Vector3f(*self.camera.axis.tolist())
        cosine_lens = -dr.dot(to_lens, axis)
        leaving = dr.dot(wall.n, to_lens)
        seen = lit & (clear > 0.0) & (cosine_lens > 0.0) & (leaving > 0.0)
        share = mi.Float64(emitted) * mi.Float64(scattered) * mi.Float64(textured) * mi.Float64(clear * foreshortened)
        share *= mi.Float64(leaving * cosine_lens) / dr.square(mi.Float64(source_m) * mi.Float64(lens_m))
        radiance = dr.select(seen, share * self._constant(), 0.0)
        lambert = dr.select(seen, np.pi * scattered * clear / cosine_in, 0.0)

        parts = [radiance, lambert, dr.select(seen, cosine_in, 0.0), dr.select(seen, cosine_out, 0.0)]
        dr.eval(*parts, hit.t)  # one kernel for all
        return CarriedLight(*(np.asarray(part, np.float64) for part in parts))

    def _constant(self) -> float:
        camera = self.camera
        pixel_area = self.view.pixel_pitch_m**2 * self.view.footprint
        return (
            pixel_area * 0.25 * np.pi * camera.pupil_diameter_m**2 * camera.transmission * camera.electronics.quantum_efficiency
        )

    def _source(self, spread: mi.Point2f) -> tuple[mi.SurfaceInteraction3f, mi.Bool]:
        """Return points of the spot on the virtual source, and whether the beam meets its front there."""
        origin = _disc(self.laser.origin, self.laser.direction, self.laser.spot_diameter_m, spread)
        hit = self.scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(*self.laser.direction.tolist())))
        return hit, hit.is_valid()

    def _wall(self, spread: mi.Point2f) -> tuple[mi.SurfaceInteraction3f, mi.Bool]:
        """Return points of the frame on the virtual detector, and whether the camera sees them."""
        view, (height, width) = self.view, self.view.extent_m
        place = (
            mi.Vector3f(*(view.centre - view.pupil_centre).tolist())
            + (spread.x - 0.5) * height * mi.Vector3f(*view.down.tolist())
            + (spread.y - 0.5) * width * mi.Vector3f(*view.right.tolist())
        )
        hit = self.scene.ray_intersect(mi.Ray3f(mi.Point3f(*view.pupil_centre.tolist()), dr.normalize(place)))
        return hit, hit.is_valid()

    def _pupil(self, spread: mi.Point2f) -> mi.Point3f:
        return _disc(self.camera.pupil_centre, self.camera.axis, self.camera.pupil_diameter_m, spread)


def _spread(count: int) -> tuple[mi.Point2f, mi.Point2f, mi.Point2f]:
    """Return three points of the unit square per sample, from one sequence in six dimensions."""
    steps = _GOLDEN_6 ** -np.arange(1.0, 7.0)
    # Short runs of the sequence, each shifted at random, because one long run would interfere with the raster of the samples.
    runs = -(-count // _RUN)
    shifts = np.random.default_rng(count).random((6, runs, 1))
    parts = [
        mi.Float(np.ravel((shift + np.arange(_RUN) * step) % 1.0)[:count].astype(np.float32))
        for shift, step in zip(shifts, steps, strict=True)
    ]
    return mi.Point2f(parts[0], parts[1]), mi.Point2f(parts[2], parts[3]), mi.Point2f(parts[4], parts[5])


def _disc(centre: np.ndarray, axis: np.ndarray, diameter: float, spread: mi.Point2f) -> mi.Point3f:
    """Return points spread uniformly over a disc."""
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    along = np.cross(axis, across)
    sine, cosine = dr.sincos(2.0 * np.pi * spread.x)
    radius = 0.5 * diameter * dr.sqrt(spread.y)
    return (
        mi.Point3f(*centre.tolist())
        + radius * cosine * mi.Vector3f(*across.tolist())
        + radius * sine * mi.Vector3f(*along.tolist())
    )
