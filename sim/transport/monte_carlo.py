"""Monte Carlo light budget with Mitsuba's shapes and BSDFs: the light of the hidden object, and stray light.

Paths start at a random point of the frame. Towards a shape they aim at a disc that covers its bounding sphere, so that the
variance stays low at -182 dB. Every vertex is connected to a random point of the laser spot, and the wall to a random point of the
pupil (next-event estimation; Veach, PhD thesis 1997, sections 8.3 and 9.2). The estimate shares no geometry with the light budget
of the frames (`light_transport.py`): another sampling, and the camera's rays instead of a pixel footprint.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from correlograph.errors import InputError
from radiometry.photons import decibel
from sim.plugins.speckle_camera import SpeckleCamera
from sim.transport.hidden_object import is_hidden_object
from sim.transport.path_ends import Aim, PathEnds, mixture
from sim.transport.surfaces import evaluate_bsdf, is_one_of

DEFAULT_SAMPLES = 2**20
BATCH = 2**20
BOUNCES = 4
"""Maximum number of reflections between laser spot and frame on paths of stray light."""

MAX_AIMS = 16
"""Number of shapes that paths aim at; light by other shapes is found by chance, with higher variance."""

_NORMAL_95 = 1.959963985


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
        """Return the estimate for JSON; null without light."""
        decibels = [value if math.isfinite(value) else None for value in map(decibel, (self.per_frame, *self.interval))]
        return {"per_frame_db": decibels[0], "interval_db": decibels[1:], "samples": self.samples}


@dataclass(frozen=True)
class OtherLight:
    """Light from the laser spot that reaches the frame other than by one reflection off the hidden object.

    Attributes:
        total: light of the whole frame.
        position: world positions (n, 3) of its last reflection before the virtual detector, for the paths that carried light.
        weight: photoelectrons of a frame per laser photon of each path, (n,); they sum to the total.
        path_m: length of each path from the centre of the spot to that of the frame, (n,).
        shape: index in `names` of the shape of that last reflection, (n,).
    """

    total: MonteCarlo
    position: np.ndarray
    weight: np.ndarray
    path_m: np.ndarray
    shape: np.ndarray
    names: tuple[str, ...]

    @property
    def fractions(self) -> Mapping[str, float]:
        """Fraction of the light whose last reflection was on each shape, largest first."""
        by_shape = np.bincount(self.shape, self.weight, len(self.names))
        return {self.names[n]: float(by_shape[n] / by_shape.sum()) for n in np.argsort(-by_shape) if by_shape[n] > 0.0}

    def scale(self, factor: float) -> OtherLight:
        """Return the same light, stronger by a factor."""
        total = self.total
        total = MonteCarlo(factor * total.per_frame, factor * total.standard_error, total.samples)
        return replace(self, total=total, weight=factor * self.weight)


def estimate_throughput(
    scene: mi.Scene, samples: int = DEFAULT_SAMPLES, seed: int = 0, camera: SpeckleCamera | None = None
) -> MonteCarlo:
    """Estimate the light of the hidden object in a frame of a loaded scene.

    Raises InputError for too few samples.
    """
    return _mean(np.concatenate([_object_light(paths) for paths in _batches(scene, samples, seed, camera)]))


def estimate_other_light(
    scene: mi.Scene, samples: int = 2**16, seed: int = 0, camera: SpeckleCamera | None = None
) -> OtherLight:
    """Estimate the stray laser light in a frame, by clutter or by several reflections.

    Direct light from the spot is excluded; see `Geometry.direct_light`. Raises InputError for too few samples.
    """
    batches = [_other_light(paths) for paths in _batches(scene, samples, seed, camera)]
    light, position, path_m, shape = (np.concatenate(parts) for parts in zip(*batches, strict=True))
    place, bounce = np.nonzero(light)
    names = tuple(shape.id() for shape in scene.shapes())
    lit = light[place, bounce]
    return OtherLight(_mean(light.sum(1)), position[place], lit / len(light), path_m[place, bounce], shape[place], names)


def _object_light(paths: PathEnds) -> np.ndarray:
    """Return the light of the hidden object carried by each path of a batch."""
    aims = [Aim(shape) for shape in paths.scene.shapes() if is_hidden_object(shape)]
    chances = np.array([aim.radius_m**2 for aim in aims])
    chances = np.cumsum(chances / chances.sum())
    pick, total = paths.uniform(), mi.Float64(0.0)
    start = paths.wall.p
    for index, aim in enumerate(aims):
        low = float(chances[index - 1]) if index else -1.0
        mine = paths.active & (pick > low) & (pick <= float(chances[index]))
        chance = float(chances[index]) - max(low, 0.0)
        direction, density = aim.sample(paths, start)
        imaged = evaluate_bsdf(paths.wall, direction, mine)
        mine &= imaged > 0.0
        for hit, share, seen in paths.hits(mi.Ray3f(start + 1e-4 * aim.distance(start) * direction, direction), mine):
            seen = seen & (hit.shape == mi.ShapePtr(aim.shape))
            hit.wi = hit.to_local(-direction)
            radiance = paths.lit_by_spot(hit, seen)
            total += dr.select(seen, radiance * mi.Float64(imaged * share) / (mi.Float64(density) * chance), 0.0)
    return np.asarray(total * paths.collected, np.float64)


def _other_light(paths: PathEnds) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the stray light of each path of a batch (n, bounces) by its number of reflections, position of its last reflection (n, 3),
    path length (n, bounces), and number of the shape of that reflection (n,).
    """
    shapes = sorted(paths.scene.shapes(), key=lambda shape: not is_hidden_object(shape))
    aims = [Aim(shape) for shape in shapes if shape.id() not in ("virtual_detector", "virtual_source")][:MAX_AIMS]
    vertex, active = paths.wall, mi.Bool(paths.active)
    weight, found, lengths, first = paths.collected, [], [], None
    number = np.zeros(len(np.asarray(weight)), int)
    for _ in range(BOUNCES):
        direction, density = mixture(paths, aims, vertex)
        value = evaluate_bsdf(vertex, direction, active)
        active &= (value > 0.0) & (density > 0.0)
        weight = dr.select(active, weight * mi.Float64(value) / mi.Float64(density), 0.0)
        hit, stopping = paths.find_obstruction(vertex.spawn_ray(direction), active)
        active &= hit.is_valid() & (stopping > 0.0)
        weight = dr.select(active, weight / mi.Float64(stopping), 0.0)
        hit.wi = hit.to_local(-direction)
        of_object = is_one_of(hit, [shape for shape in shapes if is_hidden_object(shape)])
        radiance = paths.lit_by_spot(hit, active)
        counts = active & ~of_object if first is None else active
        found.append(np.asarray(dr.select(counts, weight * radiance, 0.0), np.float64))
        if first is None:
            way = dr.norm(hit.p - paths.frame_centre)
            first = np.asarray(hit.p, np.float64).T
            for index, shape in enumerate(paths.scene.shapes()):
                number[np.asarray(hit.shape == mi.ShapePtr(shape))] = index
        else:
            way = way + dr.norm(hit.p - vertex.p)
        lengths.append(np.asarray(way + dr.norm(hit.p - paths.spot_centre), np.float64))
        vertex = hit
    return np.stack(found, 1), first, np.stack(lengths, 1), number


def _batches(scene: mi.Scene, samples: int, seed: int, camera: SpeckleCamera | None) -> Iterator[PathEnds]:
    if samples < 2:
        raise InputError("samples", "at least 2", samples, "increase --samples")
    for number, start in enumerate(range(0, samples, BATCH)):
        yield PathEnds(scene, min(BATCH, samples - start), seed * 65537 + number, camera)


def _mean(values: np.ndarray) -> MonteCarlo:
    return MonteCarlo(float(values.mean()), float(values.std(ddof=1)) / math.sqrt(len(values)), len(values))
