"""Scene geometry and light path, in float64."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from radiometry.light_budget_rows import LightPath, detector_to_pixel, light_budget
from radiometry.motion import Motion
from radiometry.photons import photon_rate
from sim.camera_view import CameraView
from sim.propagation.sampling import canvas, period
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
class Geometry:
    """Geometry of a scene. Lengths in metres, vectors in world axes (3,).

    Attributes:
        is_direct_path_blocked: whether a shape stands on the straight line from the virtual source to the virtual detector.
        direct_light: irradiance of the virtual detector by light straight from the virtual source, per laser power, in 1/m^2;
            zero if a baffle or the orientation of the walls blocks it.
        is_depolarised: whether the light of a frame is depolarised, so that the frame is the incoherent sum of two speckle patterns.
        object_velocity_m_s: velocity of the hidden object in world axes (3,).
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
    object_velocity_m_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
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
    def object_speed_m_s(self) -> tuple[float, float]:
        """Speed across the line of sight along the object's axes (rows, columns)."""
        down, right = self.hidden_object.axes.coordinates(self.object_velocity_m_s)
        return float(down), float(right)

    @property
    def motion(self) -> Motion:
        """Motion during one exposure."""
        exposure_s, (down, right) = self.camera.electronics.exposure_s, self.object_speed_m_s
        return Motion(
            self.spot.scan_speed_m_s * exposure_s / self.spot.diameter_m,
            (down * exposure_s, right * exposure_s),
            self.wavelength_m * self.source_distance_m / self.spot.diameter_m,
            (1.0 / self.source_distance_m + 1.0 / self.distance_m) / self.wavelength_m,
        )

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
    def canvas_shape(self) -> tuple[int, int]:
        """Pixels (rows, columns) on which the field is computed: the frame and a border for the blur of the camera."""
        return canvas(self.camera.frame_shape)

    @property
    def period_shape(self) -> tuple[int, int]:
        """Period (rows, columns), in pixels, of the field on the wall if samples of the object are `object_pitch_m` apart."""
        grains = [
            self.wavelength_m * self.distance_m / (extent * pitch)
            for extent, pitch in zip(self.hidden_object.extent_m, self.seen_pitch_m, strict=True)
        ]
        return period(self.canvas_shape, (grains[0], grains[1]))

    @property
    def object_pitch_m(self) -> tuple[float, float]:
        """Sample spacing on the object (down, right) for which one FFT covers exactly `period_shape` pixels."""
        rows, columns = (
            self.wavelength_m * self.distance_m / (n * pitch)
            for n, pitch in zip(self.period_shape, self.seen_pitch_m, strict=True)
        )
        return rows, columns
