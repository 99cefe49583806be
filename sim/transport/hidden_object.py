"""The hidden object as seen from the virtual detector: light of its surface, on any grid across the line of sight."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from correlograph.errors import InputError
from sim.plugins.phase_screen import PhaseScreen
from sim.propagation.option import Visibility
from sim.transport.footprint import LagAxes
from sim.transport.light_transport import CarriedLight, LightTransport
from sim.transport.ray_grid import GridRays, VisibleSurface, cell_sums, cells, centre_in, points
from sim.transport.surfaces import check_energy, has_masks, is_one_of, layers, transmittance

RAYS = 768
"""Minimum number of rays along the longer side of the object."""

MAX_CELL_RAYS = 64
"""Maximum number of rays along a side of one cell."""

SAME_PLACE = 5e-3
"""Distance below which two positions of an object count as equal, as a fraction of its radius."""


def is_hidden_object(shape: mi.Shape) -> bool:
    return shape.id().startswith("hidden_object")


@dataclass(frozen=True)
class ObjectTotals:
    """Sums over the whole object.

    Attributes:
        throughput: photoelectrons in a pixel per laser photon.
        albedo_area_m2: integral of the albedo over the visible, lit surface.
        cosine_in, cosine_out: mean cosines towards virtual source and virtual detector, weighted as in that integral.
        albedo_over_radiance: sum of the albedo over the sum of the radiance, a factor that converts radiance to effective
            albedo.
    """

    throughput: float
    albedo_area_m2: float
    cosine_in: float
    cosine_out: float
    albedo_over_radiance: float


class HiddenObject:
    """All shapes whose id starts with `hidden_object`, seen from the point of the virtual detector in the centre of the frame.

    Rays leave this point through a grid in the plane across the line of sight that holds the object's centre; rows
    run along `axes.down`, columns along `axes.right`. Each ray stands for the solid angle of its cell.

    Args:
        groups: shapes that move together, for `VisibleSurface.part`; together they are all shapes of the object.
    """

    def __init__(self, transport: LightTransport, centre: np.ndarray, axes: LagAxes, groups: list[list[mi.Shape]]) -> None:
        self._scene, self._groups = transport.scene, groups
        self._shapes = [shape for group in groups for shape in group]
        self.axes = axes
        low, high = bounds(self._shapes)
        self.centre = centre
        line = self.centre - transport.view.centre
        self._distance_m = float(np.linalg.norm(line))
        self._line_m, self.line_of_sight = line, line / self._distance_m
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        corners -= self.centre
        along = corners @ self.line_of_sight
        self.depth_m = float(np.ptp(along))
        self._radius_m = float(np.linalg.norm(corners, axis=1).max())
        self._flat = self.depth_m <= 1e-3 * self._radius_m
        self._transport = replace(transport, most_foreshortened=math.inf) if self._flat else transport
        if self._radius_m > 1e-6 and along.min() <= -0.9 * self._distance_m:
            raise InputError(
                "hidden_object",
                "all of it farther than a tenth of its distance from the virtual detector",
                f"a part {self._distance_m + along.min():.3g} m away",
                "move one of them",
            )
        seen = self.axes.coordinates(corners * (self._distance_m / (self._distance_m + along))[:, None])
        # Grids are centred on the object's centre.
        self.extent_m = tuple(2.0 * float(np.abs(seen[:, axis]).max()) for axis in (0, 1))
        if min(self.extent_m) <= 1e-6 * max(self.extent_m):
            raise InputError(
                "hidden_object",
                "a shape with a surface towards the virtual detector",
                f"{self.extent_m[1]:g} x {self.extent_m[0]:g} m",
                "correct its to_world",
            )
        displaced = float((np.abs(along) / (self._distance_m + along)).max()) * transport.frame_reach_m
        self._parallax = 1.0 + 2.0 * displaced / min(self.extent_m)
        self._measured = self._measure()
        self.height_rms_m = min(
            (shape.bsdf().height_rms_m for shape in self._shapes if isinstance(shape.bsdf(), PhaseScreen)), default=math.inf
        )
        """Lowest surface roughness; a BSDF other than phase_screen counts as rough."""

    def sample(self, pitch_m: tuple[float, float], shape: tuple[int, int]) -> VisibleSurface:
        """Sample on a grid (rows, columns) of cells `pitch_m` along the axes, centred on the object."""
        inner = tuple(min(n, cells(extent, pitch, n)) for n, extent, pitch in zip(shape, self.extent_m, pitch_m, strict=True))
        light_of, depth = np.zeros((len(self._groups), *inner)), np.zeros(inner)
        fineness = self._rays_per_cell(pitch_m)
        rays = GridRays(self.axes, self._line_m, pitch_m, inner, fineness)
        for carried, behind, group in self._layers(rays):
            light = carried.radiance * rays.angle
            for index, total in enumerate(light_of):
                total += cell_sums(np.where(group == index, light, 0.0), inner, fineness)
            depth += cell_sums(light * behind, inner, fineness)
        for light, coordinates, behind, group in self._beyond(rays):
            cell = np.round(coordinates / pitch_m + 0.5 * (np.array(inner) - 1.0)).astype(int)
            held = ((cell >= 0) & (cell < inner)).all(1)
            np.add.at(light_of, (group[held], *cell[held].T), light[held])
            np.add.at(depth, tuple(cell[held].T), (light * behind)[held])
        angle, weight = cell_sums(rays.angle, inner, fineness), light_of.sum(0)
        mean_depth = np.divide(depth, weight, out=np.zeros(inner), where=weight > 0.0)
        albedo = weight / angle * self._measured.albedo_over_radiance
        found = (weight, albedo.astype(np.float32), mean_depth, light_of.argmax(0))
        return VisibleSurface(*(centre_in(part, shape) for part in found))

    def cell_means(self, pitch_m: float | tuple[float, float], side: int) -> np.ndarray:
        """Return the effective albedo averaged over each cell of a square grid, float32 (side, side); its sum times the cell
        area does not depend on the pitch.
        """
        return self.sample(pitch_m if isinstance(pitch_m, tuple) else (pitch_m, pitch_m), (side, side)).albedo

    def position(self, coordinates: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        """Return positions relative to the object's centre, (n, 3), of samples at grid coordinates (n, 2), `depth_m` behind the
        grid plane."""
        plane = coordinates[:, :1] * self.axes.down + coordinates[:, 1:] * self.axes.right
        nearer = (1.0 + depth_m / self._distance_m)[:, None]
        return plane * nearer + depth_m[:, None] * self.line_of_sight

    def visible_from(self, detector: np.ndarray, wall_centre_m: np.ndarray) -> Visibility | None:
        """Return the amplitude transmitted between points of the wall and samples of the object; None if nothing can occlude.

        Args:
            detector: frame centre in the world, `wall_centre_m` from the object's centre.
        """
        scene, origin, masks = self._scene, detector - wall_centre_m, has_masks(self._scene)
        named = ("virtual_source", "virtual_detector")
        if all(shape in self._shapes or shape.id() in named for shape in scene.shapes()):
            return None

        def visible(places: np.ndarray, samples: np.ndarray) -> np.ndarray:
            start, end = (
                np.broadcast_to(side, (len(places), len(samples), 3)).reshape(-1, 3)
                for side in ((origin + places)[:, None], (origin + samples)[None])
            )
            # Ends just in front of the object, and of its place at rest; mutual occlusion of its parts is already part of the samples'
            # light.
            way = end - start
            length = np.linalg.norm(way, axis=1)
            to_rest = ((origin - start) * way).sum(1) / length
            traced = (np.minimum(length, to_rest) - 2.0 * self._radius_m) / length
            end = start + way * np.clip(traced, 0.1, 1.0 - 1e-3)[:, None]
            share = transmittance(scene, mi.Point3f(points(start)), mi.Point3f(points(end)), mi.Bool(True), masks=masks)
            return np.sqrt(np.asarray(share)).reshape(len(places), len(samples))

        return visible

    @property
    def frame_centre(self) -> np.ndarray:
        return self._transport.view.centre

    @property
    def throughput(self) -> float:
        """Photoelectrons in a pixel per laser photon, summed over the surface."""
        return self._measured.throughput

    def albedo_area_m2(self) -> float:
        """Integral of the albedo (pi times the BSDF) over the visible, lit surface."""
        return self._measured.albedo_area_m2

    def mean_cosines(self) -> tuple[float, float]:
        """Mean cosines towards the virtual source and the virtual detector."""
        return self._measured.cosine_in, self._measured.cosine_out

    def _rays_per_cell(self, pitch_m: tuple[float, float]) -> int:
        """Return the rays along one side of a cell."""
        along = max(extent / pitch for extent, pitch in zip(self.extent_m, pitch_m, strict=True))
        return int(np.clip(math.ceil(RAYS / max(along, 1.0)), 2, MAX_CELL_RAYS))

    def _layers(self, rays: GridRays) -> Iterator[tuple[CarriedLight, np.ndarray, np.ndarray]]:
        """Yield the light, the depth and the group of each surface along rays from the frame centre, on the grid of the rays.

        The nearest surface comes first; surfaces behind a partly transparent one follow it.
        """
        skipped = self._before(rays.length)
        start = self._transport.view.centre + skipped[:, None] * rays.direction
        ray = mi.Ray3f(points(start), mi.Vector3f(points(rays.direction)))
        gone = mi.Float(0.0)
        for hit, active in layers(self._scene, ray, mi.Bool(True)):
            mine = is_one_of(hit, self._shapes) & active
            check_energy("hidden_object", hit, mine)
            carried = self._transport.compute_carried_light(hit, mine)
            gone += dr.select(active, hit.t, 0.0)
            way = np.asarray(gone, np.float64) + skipped
            yield (
                CarriedLight(*map(rays.grid, vars(carried).values())),
                rays.grid(way * rays.cosine - self._distance_m),
                rays.grid(self._group_of(hit)),
            )

    def _group_of(self, hit: mi.SurfaceInteraction3f) -> np.ndarray:
        """Return the index of the group of each surface, (n,); 0 for shapes of none."""
        found = np.zeros(dr.width(hit.t), int)
        for index, group in enumerate(self._groups[1:], 1):
            found[np.asarray(is_one_of(hit, group))] = index
        return found

    def _beyond(self, rays: GridRays) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Yield light of surfaces that the frame centre does not see, or sees too obliquely: light, coordinates (n, 2), depths, groups.

        Each ray comes from another point of the frame. A flat object cannot occlude itself.
        """
        if self._flat:
            return
        transport = self._transport
        # Off-centre pixels see deep parts displaced, so the grid is wider.
        wider = self._parallax
        plane = mi.Point3f(points(self.centre + wider * rays.place))
        eye = transport.frame_points(dr.width(plane))
        way = plane - eye
        length = dr.norm(way)
        direction = way / length
        ray = mi.Ray3f(eye + direction * self._before(length), direction)
        cosine = np.asarray(dr.dot(direction, mi.Vector3f(*self.line_of_sight.tolist())), np.float64)
        angle = wider**2 * rays.area * cosine / np.asarray(length, np.float64) ** 2
        for hit, active in layers(self._scene, ray, mi.Bool(True)):
            share = transport.foreshortening(hit, eye)
            mine = is_one_of(hit, self._shapes) & active
            mine &= ~self._seen_from_centre(hit, mine & (share > 0.0) & (share <= transport.most_foreshortened))
            carried = transport.compute_carried_light(hit, mine, from_centre=False)
            found = carried.radiance > 0.0
            position = np.asarray(hit.p, np.float64).T[found] - self.centre
            depth = position @ self.line_of_sight
            seen = self.axes.coordinates(position * (self._distance_m / (self._distance_m + depth))[:, None])
            yield (carried.radiance * angle)[found], seen, depth, self._group_of(hit)[found]

    def _seen_from_centre(self, hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Return whether a ray of `_layers` meets a surface.

        The ray is traced towards the surface: single-precision rays that leave a curved surface at a grazing angle may meet it again.
        """
        centre = mi.Point3f(*self._transport.view.centre.tolist())
        outward = dr.normalize(hit.p - centre)
        whole = self._distance_m / dr.dot(outward, mi.Vector3f(*self.line_of_sight.tolist()))
        ray, seen = mi.Ray3f(centre + outward * self._before(whole), outward), mi.Bool(False)
        for met, there in layers(self._scene, ray, active):
            seen |= there & (dr.norm(met.p - hit.p) < SAME_PLACE * self._radius_m)
        return seen

    def _before(self, length: Any) -> Any:
        """Return the distance along a ray to just before the object, whose centre plane is `length` along it.

        Rays that start there keep the precision of the depth at any distance from the wall.
        """
        gap, least = length - (2.0 * self._radius_m + 1e-3 * self._distance_m), 1e-4 * self._distance_m
        return np.maximum(gap, least) if isinstance(gap, np.ndarray) else dr.select(gap > least, gap, least)

    def _measure(self) -> ObjectTotals:
        """Return sums over the whole object, with `RAYS` along its longer side."""
        pitch = max(self.extent_m) / RAYS
        shape = tuple(int(np.ceil(extent / pitch)) or 1 for extent in self.extent_m)
        rays = GridRays(self.axes, self._line_m, (pitch, pitch), (shape[0], shape[1]), 1)
        throughput = radiance = albedo = area = cosine_in = cosine_out = 0.0
        for carried, behind, _ in self._layers(rays):
            throughput += float((carried.radiance * rays.angle).sum())
            radiance += float(carried.radiance.sum())
            albedo += float(carried.albedo.sum())
            lit = carried.cosine_out > 0.0
            surface = carried.albedo * rays.angle * (self._distance_m + behind) ** 2
            surface = np.where(lit, surface / np.where(lit, carried.cosine_out, 1.0), 0.0)
            area += float(surface.sum())
            cosine_in += float((surface * carried.cosine_in).sum())
            cosine_out += float((surface * carried.cosine_out).sum())
        throughput += sum(float(light.sum()) for light, *_ in self._beyond(rays))
        if area == 0.0:
            return ObjectTotals(throughput, 0.0, 1.0, 1.0, 0.0)
        return ObjectTotals(
            throughput,
            area,
            min(cosine_in / area, 1.0),
            min(cosine_out / area, 1.0),
            albedo / radiance if radiance > 0.0 else 0.0,
        )


def bounds(shapes: list[mi.Shape]) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the bounding box of shapes. Raises InputError if it is not finite."""
    boxes = [shape.bbox() for shape in shapes]
    low = np.min([np.asarray(box.min, np.float64) for box in boxes], axis=0)
    high = np.max([np.asarray(box.max, np.float64) for box in boxes], axis=0)
    if not np.isfinite([low, high]).all() or np.abs([low, high]).max() > 1e9:
        raise InputError("hidden_object", "a finite place and size", f"{low} to {high}", "correct its to_world")
    return low, high
