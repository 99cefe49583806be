"""Stray laser light: clutter and multiple reflections.

Stray light whose path length differs from the object's by less than the coherence length adds to the object's light as a field.
Both appear in the autocorrelation, with cross terms (beats) at lags of their distance. After a path difference of c tau, the beats are
lower by gamma(tau)^2 (`radiometry/coherence.py`). Light with longer or shorter paths, and
light from directions that the pixels do not resolve against the object, adds in intensity. Its speckle is that of a source that
comprises all positions which emit it, as far as pupil and pixel resolve it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.constants import speed_of_light

from radiometry.coherence import coherence, reach_m
from radiometry.motion import disc_overlap
from radiometry.transfer import amplitude_transfer
from sim.geometry import Geometry
from sim.optics.motion import Pose
from sim.optics.object_samples import ObjectSamples
from sim.propagation.fraunhofer import far_field
from sim.propagation.sampling import middle, phasor

_PAIRS = 20_000

_BINS_PER_REACH = 64
"""Bins of the path length within one cell, per reach of the coherence."""


@dataclass(frozen=True)
class Emitters:
    """Cells in the plane of the object that emit stray light.

    Attributes:
        share: their light in units of the hidden object's.
        offset: rows and columns from the object's centre, in units of `Geometry.object_pitch_m`, (n, 2).
        amplitude: amplitude of each, sum of squares 1, (n,).
        path_m: length of the path by each minus that by the object's centre, (n,).
    """

    share: float
    offset: np.ndarray
    amplitude: np.ndarray
    path_m: np.ndarray

    def waves(self, geometry: Geometry, poses: list[Pose], rng: np.random.Generator) -> np.ndarray:
        """Sample the illumination of each cell in each sub-exposure, complex (poses, n); spots in different places share less of it."""
        moved = np.array([pose.spot_m for pose in poses]) / geometry.spot.diameter_m
        shared = disc_overlap(np.abs(moved[:, None] - moved[None]))
        power, vectors = np.linalg.eigh(shared)
        used = power > 1e-9 * power.max()
        white = rng.standard_normal((2, int(used.sum()), len(self.amplitude))) * np.sqrt(0.5)
        return (vectors[:, used] * np.sqrt(power[used])) @ (white[0] + 1j * white[1]) * self.amplitude

    def field(
        self, geometry: Geometry, waves: np.ndarray, offset_hz: float, oversampling: int, origin: tuple[float, float]
    ) -> np.ndarray:
        """Return their field on the canvas, (oversampling H, oversampling W), mean square 1.

        Args:
            waves: illumination of each cell, (n,).
            offset_hz: offset of a spectral line from the laser frequency.
            origin: position of the object's centre on the grid of the propagator.
        """
        period = tuple(oversampling * side for side in geometry.period_shape)
        place = np.round(self.offset + origin).astype(int) % period
        grid = np.zeros(period, np.complex128)
        delayed = waves * phasor(self.path_m * offset_hz, speed_of_light) if offset_hz else waves
        np.add.at(grid, (place[:, 0], place[:, 1]), delayed)
        canvas = (geometry.canvas_shape[0] * oversampling, geometry.canvas_shape[1] * oversampling)
        return middle(far_field(torch.from_numpy(grid.astype(np.complex64)), (period[0], period[1])), canvas)


@dataclass(frozen=True)
class Background:
    """Stray light that adds in intensity.

    Attributes:
        emitters: all cells that emit it.
        contrast: contrast of its speckle before pupil and pixels reduce it; 1 if it comes from a region no larger than the object.
    """

    emitters: Emitters
    contrast: float

    def intensity(self, geometry: Geometry, rng: np.random.Generator, device: torch.device) -> torch.Tensor:
        """Sample its intensity on the canvas, mean 1, before pupil and pixel; (H, W)."""
        if self.contrast == 0.0:
            return torch.ones(geometry.canvas_shape, device=device)
        wall = self.emitters.field(geometry, self.emitters.waves(geometry, [Pose()], rng)[0], 0.0, 1, (0.0, 0.0)).to(device)
        return (wall.real.square() + wall.imag.square()) * self.contrast + (1.0 - self.contrast)


@dataclass(frozen=True)
class StrayLight:
    """Stray light of a scene: what adds as a field, and what adds in intensity; None for a part without light."""

    coherent: Emitters | None
    background: Background | None

    @property
    def coherent_share(self) -> float:
        """Light that beats with the object's, in units of the object's."""
        return 0.0 if self.coherent is None else self.coherent.share

    def joint_paths(self, samples: ObjectSamples) -> tuple[np.ndarray, np.ndarray]:
        """Return path lengths and amplitudes (n,) of the object's samples and of the stray light that beats with them."""
        if self.coherent is None:
            return samples.path_m, samples.amplitude
        strength = np.sqrt(self.coherent.share * samples.brightness)
        return (
            np.concatenate([samples.path_m, self.coherent.path_m]),
            np.concatenate([samples.amplitude, strength * self.coherent.amplitude]),
        )


def stray_light_of(geometry: Geometry, samples: ObjectSamples, even_below: float) -> StrayLight:
    """Return the stray light of a scene; a background is uniform if its speckle adds less than `even_below` to the variance of the
    object's speckle.
    """
    other, hidden = geometry.other_light, geometry.hidden_object
    if other is None or other.total.per_frame == 0.0 or hidden.throughput == 0.0 or len(samples.path_m) == 0:
        return StrayLight(None, None)
    offset = other.position - hidden.centre
    away = np.linalg.norm(hidden.centre - geometry.camera.centre)
    along = away + offset @ hidden.line_of_sight
    # Directions as the frame centre sees them; light from across or behind the line of sight has no lag of its own.
    along = np.where(along > 0.05 * away, along, 0.05 * away)
    seen = hidden.axes.coordinates(offset * (away / along)[:, None]) / geometry.object_pitch_m
    path = other.path_m - away - float(np.linalg.norm(hidden.centre - geometry.spot.centre))
    beats = beats_with_object(geometry, seen) & (path < samples.path_m.max() + reach_m(geometry.spot.linewidth_hz))
    beats &= path > samples.path_m.min() - reach_m(geometry.spot.linewidth_hz)
    unit = geometry.other_light_share / other.total.per_frame
    coherent, apart = (
        _emitters(geometry, seen[chosen], path[chosen], other.weight[chosen] * unit) for chosen in (beats, ~beats)
    )
    if apart is None:
        return StrayLight(coherent, None)
    return StrayLight(coherent, Background(apart, _contrast(geometry, apart, even_below)))


def beats_with_object(geometry: Geometry, seen: np.ndarray) -> np.ndarray:
    """Return which positions (n, 2), in units of the sample spacing from the object's centre, beat with the whole object within one
    period of the wall field.
    """
    extent = np.array(geometry.hidden_object.extent_m) / geometry.object_pitch_m
    return (np.abs(seen) < 0.5 * (np.array(geometry.period_shape) - extent)).all(1)


def visibility_by_shape(geometry: Geometry, samples: ObjectSamples) -> dict[str, float]:
    """Return, for each shape that sends stray light, by which factor its beats with the object are lowered: the mean of gamma^2."""
    other = geometry.other_light
    if other is None or len(samples.path_m) == 0 or len(other.path_m) == 0:
        return {}
    centre = geometry.hidden_object.centre
    direct = float(np.linalg.norm(centre - geometry.camera.centre) + np.linalg.norm(centre - geometry.spot.centre))
    delay = (other.path_m - direct - float(np.average(samples.path_m, weights=samples.amplitude**2))) / speed_of_light
    left = coherence(delay, geometry.spot.linewidth_hz) ** 2
    total = np.bincount(other.shape, other.weight, len(other.names))
    kept = np.bincount(other.shape, other.weight * left, len(other.names))
    return {other.names[n]: float(kept[n] / total[n]) for n in np.flatnonzero(total)}


def _emitters(geometry: Geometry, seen: np.ndarray, path_m: np.ndarray, power: np.ndarray) -> Emitters | None:
    """Gather paths of one cell and nearly one length; None without light."""
    share = float(power.sum())
    if share == 0.0:
        return None
    reach = reach_m(geometry.spot.linewidth_hz)
    lengths = np.zeros(len(path_m)) if np.isinf(reach) else np.round(path_m * (_BINS_PER_REACH / reach))
    keys = np.column_stack([np.round(seen), lengths])
    index = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    total = np.bincount(index, power)
    means = [np.bincount(index, power * values) / total for values in (seen[:, 0], seen[:, 1], path_m)]
    return Emitters(share, np.column_stack(means[:2]), np.sqrt(total / share), means[2])


def _contrast(geometry: Geometry, emitters: Emitters, even_below: float) -> float:
    """Return the contrast of a background, whose period on the wall is that of the grid, after the loss by linewidth and pixels."""
    weight = emitters.amplitude**2
    pairs = np.random.default_rng(0).choice(len(weight), (2, _PAIRS), p=weight / weight.sum())
    lag = emitters.offset[pairs[0]] - emitters.offset[pairs[1]]
    delay = (emitters.path_m[pairs[0]] - emitters.path_m[pairs[1]]) / speed_of_light
    variance = float((_transfer(geometry, lag) * coherence(delay, geometry.spot.linewidth_hz) ** 2).mean())
    half = 0.5 * np.array(geometry.period_shape)
    wrapped = float(_transfer(geometry, (lag + half) % (2.0 * half) - half).mean())
    if emitters.share**2 * variance < even_below:
        return 0.0
    return float(np.sqrt(min(variance / max(wrapped, 1e-12), 1.0)))


def _transfer(geometry: Geometry, lag: np.ndarray) -> np.ndarray:
    """Return H, (n,), at lags (n, 2) in units of the sample spacing of the grid."""
    row, column = (lag / geometry.period_shape / geometry.camera.pixel_pitch_m).T
    return (
        amplitude_transfer(
            row,
            column,
            geometry.camera.pixel_pitch_m,
            geometry.camera.pupil_diameter_m,
            geometry.wavelength_m,
            geometry.camera.pupil_distance_m,
        )
        ** 2
    )
