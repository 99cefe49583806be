"""Scene geometry and light path, in float64."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from radiometry.light_budget_rows import LightPath, detector_to_pixel, light_budget
from radiometry.motion import Motion
from radiometry.photons import photon_rate
from sim.camera_view import CameraView
from sim.foreseen import FORESEEN_S, speckle_ways
from sim.laser_speckle import along_axes, grain_m, lit_place
from sim.propagation.sampling import canvas, period
from sim.trajectory import Trajectory
from sim.transport.flat_object import FlatObject
from sim.transport.hidden_object import HiddenObject
from sim.transport.monte_carlo import OtherLight


@dataclass(frozen=True)
class Spot:
    """Laser spot on the virtual source: a uniform disc on a rough wall."""

    centre: np.ndarray
    diameter_m: float
    height_rms_m: float
    correlation_length_m: float
    scan_step_m: float | None
    """Spot travel between frames; None for at least its diameter."""
    scan_speed_m_s: float
    """Speed of the spot over the wall while the shutter is open."""
    beam: np.ndarray
    """Direction of the laser's light."""
    normal: np.ndarray
    """Normal of the wall, towards the light."""
    linewidth_hz: float = 0.0
    """Full width at half maximum of the laser's line."""


@dataclass(frozen=True)
class PhotographedWall:
    """The virtual detector, as far as the camera sees it.

    Attributes:
        height_rms_m: its roughness; None without a phase_screen.
        texture: its albedo under each pixel in units of its mean, float32 (H, W); None if it is uniform.
        ambient_irradiance: irradiance by emitters other than the laser, W/m^2; a coarse map (`ambient.py`), None without any.
    """

    height_rms_m: float | None = None
    texture: np.ndarray | None = None
    ambient_irradiance: np.ndarray | None = None


@dataclass(frozen=True)
class Movement:
    """Motion of the shapes of one hidden object, which turn about their common centre (3,) in world axes."""

    trajectory: Trajectory
    centre: np.ndarray


@dataclass(frozen=True)
class Geometry:
    """Geometry of a scene. Lengths in metres, vectors in world axes (3,).

    Attributes:
        is_direct_path_blocked: whether a shape stands on the straight line from the virtual source to the virtual detector.
        direct_light: irradiance of the virtual detector by light straight from the virtual source, per laser power, in 1/m^2;
            zero if a baffle or the orientation of the walls blocks it.
        is_depolarised: whether the light of a frame is depolarised, so that the frame is the incoherent sum of two speckle patterns.
        movements: motion of each hidden object, in the order of `VisibleSurface.part`; empty if none moves.
        other_light: stray laser light, by clutter or several reflections; None if a flat object replaces that of the scene.
    """

    spot: Spot
    hidden_object: HiddenObject | FlatObject
    wall: PhotographedWall
    camera: CameraView
    light_path: LightPath
    is_direct_path_blocked: bool
    direct_light: float
    is_depolarised: bool
    movements: tuple[Movement, ...] = ()
    other_light: OtherLight | None = None

    def with_electronics(self, **values: Any) -> Geometry:
        """Return the same scene with other values of the camera's electronics."""
        electronics = replace(self.camera.electronics, **values)
        path = replace(self.light_path, quantum_efficiency=electronics.quantum_efficiency)
        return replace(self, camera=replace(self.camera, electronics=electronics), light_path=path)

    def with_exposure(self, exposure_s: float) -> Geometry:
        """Return the same scene at another exposure."""
        return self.with_electronics(exposure_s=exposure_s)

    def with_power(self, power_w: float) -> Geometry:
        """Return the same scene at another laser power."""
        return replace(self, light_path=replace(self.light_path, power_w=power_w))

    def with_wavelength(self, wavelength_m: float) -> Geometry:
        """Return the same scene at another wavelength; the reflectances of its surfaces are assumed to be equal there."""
        return replace(self, light_path=replace(self.light_path, wavelength_m=wavelength_m))

    def with_camera(self, **values: Any) -> Geometry:
        """Return the same scene with a camera of other values (`CameraView`) in the same place. The wall that it sees is assumed
        to be uniform.
        """
        camera = replace(self.camera, **values)
        pixels = camera.frame_shape[0] * camera.frame_shape[1]
        path = replace(
            self.light_path,
            pixel_area_m2=self.light_path.pixel_area_m2 * (camera.pixel_pitch_m / self.camera.pixel_pitch_m) ** 2,
            pixels=pixels,
            quantum_efficiency=camera.electronics.quantum_efficiency,
            pupil_diameter_m=camera.pupil_diameter_m,
        )
        before, after = (detector_to_pixel(one) * one.pixel_area_m2 * one.pixels for one in (self.light_path, path))
        other = self.other_light and self.other_light.scale(after / before if before > 0.0 else 0.0)
        return replace(self, camera=camera, light_path=path, wall=replace(self.wall, texture=None), other_light=other)

    def with_object(self, cells: np.ndarray, pitch_m: float | tuple[float, float]) -> Geometry:
        """Return the same scene with a flat object of albedo cells (n, n) in its place; neighbouring cells are `pitch_m`
        (rows, columns) apart.
        """
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
        """Distance from the object to the virtual detector."""
        return self.light_path.object_to_detector_m

    @property
    def other_light_share(self) -> float:
        """Ratio of stray laser light to the light of the hidden object, without ambient light."""
        if self.other_light is None or self.hidden_object.throughput == 0.0:
            return 0.0
        return self.other_light.total.per_frame / (light_budget(self.light_path).per_pixel * self.light_path.pixels)

    @property
    def ambient_photoelectrons_per_pixel_s(self) -> np.ndarray | None:
        """Photoelectrons from ambient light, a coarse map over the frame; None without any."""
        if self.wall.ambient_irradiance is None:
            return None
        path = self.light_path
        photons = photon_rate(1.0, path.wavelength_m) * path.pixel_area_m2
        return self.wall.ambient_irradiance * photons * detector_to_pixel(path)

    @property
    def moves(self) -> bool:
        """Whether an object or the camera moves."""
        return self.camera.trajectory.moves or any(one.trajectory.moves for one in self.movements)

    def with_velocity(self, velocity_m_s: np.ndarray) -> Geometry:
        """Return the same scene with a hidden object of a constant velocity in world axes (3,)."""
        movement = Movement(Trajectory(velocity_m_s=np.asarray(velocity_m_s, np.float64)), self.hidden_object.centre)
        return replace(self, movements=(movement,))

    @property
    def at_rest(self) -> Geometry:
        """The same scene in which neither an object nor the camera moves."""
        return replace(self, movements=(), camera=replace(self.camera, trajectory=Trajectory()))

    def exposure_time_s(self, number: int) -> float:
        """Return when an exposure begins."""
        return number * max(self.camera.frame_interval_s, self.camera.electronics.exposure_s)

    def frame_middle_s(self, number: int) -> float:
        """Return the middle of the exposure of a frame; the polarisation channels of a camera are frames of one exposure."""
        exposure = number // self.camera.polarisation_channels
        return self.exposure_time_s(exposure) + 0.5 * self.camera.electronics.exposure_s

    def moments(self) -> np.ndarray:
        """Return times that show every part of the motion."""
        parts = [one.trajectory.moments(FORESEEN_S) for one in self.movements]
        return np.unique(np.concatenate([*parts, self.camera.trajectory.moments(FORESEEN_S)]))

    @property
    def moves_on_lattice(self) -> bool:
        """Whether the samples of each object keep their places on a grid: it moves across the line of sight without turning, apart from a
        motion along it that at all times changes the speckle by less than a hundredth of what the motion across it does.
        """
        paths = [one.trajectory for one in self.movements]
        if any(path.turns for path in paths):
            return False
        for path in paths:
            ways = path.displacement(self.moments())
            along = np.abs(ways @ self.hidden_object.line_of_sight)
            across = np.linalg.norm(self.hidden_object.axes.coordinates(ways), axis=-1)
            scaled = along * 0.5 * max(self.camera.extent_m) / self.distance_m
            if (scaled > 0.01 * across * (1.0 + self.distance_m / self.source_distance_m) + 1e-12).any():
                return False
        return True

    @property
    def wander_m(self) -> float:
        """Distance by which turning or receding parts of the object leave the grid that they occupy at rest."""
        if self.moves_on_lattice:
            return 0.0
        ways = [one.trajectory.displacement(self.moments()) for one in self.movements]
        apart = max(float(np.linalg.norm(way - ways[0], axis=1).max()) for way in ways)
        return apart + 0.5 * max(self.hidden_object.extent_m)

    def busiest_time_s(self) -> float:
        """Return the beginning of the exposure in which objects and camera travel farthest."""
        exposure_s, times = self.camera.electronics.exposure_s, self.moments()
        paths = [(one.trajectory, 0.5 * max(self.hidden_object.extent_m)) for one in self.movements]
        travelled = np.zeros(len(times))
        for path, radius in [*paths, (self.camera.trajectory, 0.0)]:
            steps = np.linalg.norm(np.diff(path.displacement(times), axis=0), axis=1)
            if path.turns:
                turns = path.rotation(times)
                steps = steps + radius * (turns[1:] * turns[:-1].inv()).magnitude()
            travelled[1:] += np.cumsum(steps)
        begins = np.concatenate([times, times - exposure_s]).clip(0.0)
        ways = np.interp(begins + exposure_s, times, travelled) - np.interp(begins, times, travelled)
        return float(begins[int(np.argmax(ways))]) if ways.max() > ways[0] * (1.0 + 1e-9) else 0.0

    def _longest_exposure_s(self) -> tuple[float, float]:
        """Return the beginning and the end of the exposure with the longest way."""
        begin_s = self.busiest_time_s()
        return begin_s, begin_s + self.camera.electronics.exposure_s

    def _way_m(self) -> np.ndarray:
        """Return the displacement in world axes (3,) in the exposure with the longest way; of the fastest object."""
        begin_s, end_s = self._longest_exposure_s()
        ways = [one.trajectory.displacement(end_s) - one.trajectory.displacement(begin_s) for one in self.movements]
        return max(ways, key=np.linalg.norm, default=np.zeros(3))

    @property
    def object_way_m(self) -> tuple[float, float]:
        """Displacement along the object's axes (rows, columns) across the line of sight in the exposure with the longest way; of the
        fastest object."""
        down, right, _ = along_axes(self, self._way_m())
        return float(down), float(right)

    @property
    def receding_m(self) -> float:
        """Displacement along the line of sight in the exposure with the longest way; of the fastest object."""
        return float(along_axes(self, self._way_m())[2])

    @property
    def motion(self) -> Motion:
        """Motion during the exposure with the longest way, as if it were uniform, without rotation."""
        way = self._way_m()
        along = along_axes(self, way)
        return Motion(
            self.spot.scan_speed_m_s * self.camera.electronics.exposure_s / self.spot.diameter_m,
            (float(along[0]), float(along[1])),
            float(np.linalg.norm(lit_place(self, along))),
            grain_m(self),
            self._turns_per_m(way),
        )

    def _turns_per_m(self, way: np.ndarray) -> np.ndarray:
        """Return the phase turns of a sample per metre of its distance from the object's centre along its axes, (2,), in the exposure with
        the longest way (3,): by the object, and by the camera, which sees another point of the wall."""
        seen, (begin_s, end_s) = self._across_per_distance(self.camera.centre), self._longest_exposure_s()
        camera_way = self.camera.view_shift(end_s) - self.camera.view_shift(begin_s)
        by_object = (self._across_per_distance(self.spot.centre) + seen) @ way
        return (by_object - seen @ camera_way) / self.wavelength_m

    def _across_per_distance(self, end: np.ndarray) -> np.ndarray:
        """Return the object's axes (rows, columns) across the ray to a point, over the length of that ray, (2, 3)."""
        axes, way = np.stack([self.hidden_object.axes.down, self.hidden_object.axes.right]), end - self.hidden_object.centre
        return (axes - np.outer(axes @ way, way) / (way @ way)) / np.linalg.norm(way)

    @property
    def fringes_per_m2(self) -> np.ndarray:
        """Phase turns of a sample per metre of its distance from the object's centre and per metre of displacement, (2, 2), along the
        object's axes (rows, columns): second derivatives of the way from spot to wall. Obliquely, only what lies across a ray counts."""
        axes = np.stack([self.hidden_object.axes.down, self.hidden_object.axes.right])
        across = self._across_per_distance(self.spot.centre) + self._across_per_distance(self.camera.centre)
        return axes @ across.T / self.wavelength_m

    @property
    def travel(self) -> np.ndarray:
        """Pixels (rows, columns) by which the speckle moves per metre of the object's displacement along its axes, (2, 2)."""
        grid = np.stack([self.hidden_object.axes.down, self.hidden_object.axes.right])
        turns_per_pixel = grid @ np.stack([*self.hidden_object.axes.step], 1) * self.camera.pixel_pitch_m
        return np.linalg.solve(turns_per_pixel / (self.wavelength_m * self.distance_m), self.fringes_per_m2)

    @property
    def seen_pitch_m(self) -> tuple[float, float]:
        """Pixel pitches on the wall (rows, columns) as seen from the object; the lag pitch is lambda z / (patch size x this
        pitch)."""
        stretch = self.hidden_object.axes.stretch
        pitch_m = self.camera.pixel_pitch_m
        return pitch_m / stretch[0], pitch_m / stretch[1]

    @property
    def seen_pixel_area_m2(self) -> float:
        """Area of a pixel's footprint across the line of sight."""
        step_down, step_right = self.hidden_object.axes.step
        return self.camera.pixel_pitch_m**2 * float(np.linalg.norm(np.cross(step_down, step_right)))

    @property
    def blur_pixels(self) -> float:
        """Width of the camera's blur, lambda times the distance of the pupil over its diameter."""
        camera = self.camera
        return self.wavelength_m * camera.pupil_distance_m / camera.pupil_diameter_m / camera.pixel_pitch_m

    @property
    def canvas_shape(self) -> tuple[int, int]:
        """Pixels (rows, columns) on which the field is computed: the frame and a border for the blur of the camera."""
        return canvas(self.camera.frame_shape, self.blur_pixels)

    @property
    def grain_pixels(self) -> tuple[float, float]:
        """Size of a grain of the speckle (rows, columns), lambda z over the extent of the object, in pixels."""
        rows, columns = (
            self.wavelength_m * self.distance_m / (extent * pitch)
            for extent, pitch in zip(self.hidden_object.extent_m, self.seen_pitch_m, strict=True)
        )
        return rows, columns

    @property
    def is_within_a_grain(self) -> bool:
        """Whether a grain of the speckle is larger than the frame along both axes. Along one, a thin line is still seen by its length."""
        return all(grain > side for grain, side in zip(self.grain_pixels, self.camera.frame_shape, strict=True))

    @property
    def period_shape(self) -> tuple[int, int]:
        """Period (rows, columns), in pixels, of the field on the wall if samples of the object are `object_pitch_m` apart; longer if the
        speckle moves far."""
        rows, columns = speckle_ways(self, self.moments()) if self.moves else (0.0, 0.0)
        return period(self.canvas_shape, self.grain_pixels, (float(rows), float(columns)))

    @property
    def object_pitch_m(self) -> tuple[float, float]:
        """Sample spacing on the object (down, right) for which one FFT covers exactly `period_shape` pixels."""
        rows, columns = (
            self.wavelength_m * self.distance_m / (n * pitch)
            for n, pitch in zip(self.period_shape, self.seen_pitch_m, strict=True)
        )
        return rows, columns
