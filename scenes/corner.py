"""A scene round a corner from a few numbers: object, two walls, laser, camera. It needs neither XML by hand nor Mitsuba."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

from correlograph.errors import InputError, check_positive

MAX_ANGLE_DEG = 80.0
"""Maximum angle of the camera and of the virtual source off the normal."""

WALL_MARGIN = 1.8
"""Width of a wall in units of what is lit or seen of it."""

BAFFLE_PLACE, BAFFLE_SIZE = 0.22, 0.8
"""Place of the baffle on the way from virtual source to virtual detector, and its width in units of its distance from the axis."""


@dataclass(frozen=True)
class Corner:
    """The lab of Metzler et al. 2020 with other numbers. The object lies in the origin and faces +z, where both walls are.

    Attributes:
        object_width_m: width of the picture that is the object's albedo.
        source_distance_m, source_angle_deg: from the object to the virtual source, and its angle off the object's normal.
        detector_distance_m: from the object to the virtual detector, along the normal.
        camera_angle_deg: angle of the camera off the normal of the virtual detector, on the side away from the virtual source.
        pixel_pitch_m, frame_shape: pitch on the sensor; rows and columns.
        magnification, focal_length_m, f_number: the lens; the camera stands at f (1 + 1 / magnification).
        wall_albedo: reflectance of both walls, Lambertian and rough.
        read_noise, full_well, bits: the sensor, in electrons; zero for none.

    Raises InputError for values that are impossible, and for walls that stand in each other's way.
    """

    object_width_m: float = 0.01
    source_distance_m: float = 0.5
    source_angle_deg: float = 12.0
    detector_distance_m: float = 1.0
    camera_angle_deg: float = 12.0
    pixel_pitch_m: float = 3.45e-6
    frame_shape: tuple[int, int] = (2056, 2464)
    magnification: float = 0.5
    focal_length_m: float = 0.18
    f_number: float = 3.5
    wavelength_m: float = 532e-9
    power_w: float = 0.3
    spot_diameter_m: float = 5e-3
    exposure_s: float = 0.125
    wall_albedo: float = 1.0
    read_noise: float = 0.0
    full_well: float = 0.0
    bits: int = 0

    def __post_init__(self) -> None:
        angles, may_be_zero = ("source_angle_deg", "camera_angle_deg"), ("wall_albedo", "read_noise", "full_well", "bits")
        for name, value in vars(self).items():
            if name != "frame_shape" and name not in angles:
                check_positive(name, value, zero_allowed=name in may_be_zero)
        if min(self.frame_shape) < 1:
            raise InputError("frame_shape", "at least one row and one column", f"{self.frame_shape}", "enlarge the frame")
        for name in angles:
            if check_positive(name, getattr(self, name), zero_allowed=True) > MAX_ANGLE_DEG:
                raise InputError(name, f"0 to {MAX_ANGLE_DEG:g} degrees", getattr(self, name), "turn it")
        if self.wall_albedo > 1.0:
            raise InputError("wall_albedo", "0 to 1", self.wall_albedo, "correct the value")
        x, z = self.source_m
        clear = 0.5 * (self.source_width_m + max(self.detector_width_m, self.object_width_m))
        at_detector = x * self.detector_distance_m / z
        if min(x, at_detector) < clear:
            degrees = math.degrees(math.atan2(clear, min(self.source_distance_m, self.detector_distance_m)))
            found = (
                f"{self.source_angle_deg:g} degrees, at which the source ({self.source_width_m:.3g} m wide) stands before the "
                f"photographed wall ({self.detector_width_m:.3g} m) or the object ({self.object_width_m:.3g} m)"
            )
            remedy = "turn the source, or correct spot_diameter_m, pixel_pitch_m, magnification or object_width_m"
            raise InputError("source_angle_deg", f"about {degrees:.0f} degrees or more", found, remedy)

    @property
    def source_m(self) -> tuple[float, float]:
        """Place of the spot, (x, z)."""
        angle = math.radians(self.source_angle_deg)
        return self.source_distance_m * math.sin(angle), self.source_distance_m * math.cos(angle)

    @property
    def source_width_m(self) -> float:
        """Width of the virtual source."""
        return 8.0 * self.spot_diameter_m

    @property
    def footprint_m(self) -> tuple[float, float]:
        """Height and width of what the camera sees of the virtual detector, across its line of sight."""
        pitch = self.pixel_pitch_m / self.magnification
        return self.frame_shape[0] * pitch, self.frame_shape[1] * pitch

    @property
    def detector_width_m(self) -> float:
        """Width of the virtual detector."""
        return WALL_MARGIN * max(self.footprint_m) / math.cos(math.radians(self.camera_angle_deg))

    @property
    def camera_distance_m(self) -> float:
        """Distance from the virtual detector to the lens, by the equation of a thin lens."""
        return self.focal_length_m * (1.0 + 1.0 / self.magnification)

    def as_xml(self, albedo: str, aspect: float = 1.0) -> str:
        """Return the scene file.

        Args:
            albedo: file name of the picture of the object's power reflectance, next to the scene file.
            aspect: its height over its width.
        """
        x, z = self.source_m
        angle = math.radians(self.camera_angle_deg)
        camera = (-self.camera_distance_m * math.sin(angle), -self.camera_distance_m * math.cos(angle))
        electronics = "".join(
            f'\n            <float name="{name}" value="{getattr(self, name):.9g}"/>'
            for name in ("read_noise", "full_well", "bits")
            if getattr(self, name)
        )
        return _SCENE.format(
            albedo=quoteattr(albedo),
            half_width=f"{0.5 * self.object_width_m:.9g}",
            half_height=f"{0.5 * self.object_width_m * aspect:.9g}",
            laser=", ".join(f"{value:.9g}" for value in (0.58 * x, 0.5 * self.source_distance_m, 0.2 * self.source_distance_m)),
            source=f"{x:.9g}, 0, {z:.9g}",
            source_half=f"{0.5 * self.source_width_m:.9g}",
            detector_half=f"{0.5 * self.detector_width_m:.9g}",
            camera=f"{camera[0]:.9g}, 0, {camera[1]:.9g}",
            pupil=f"{self.focal_length_m / self.f_number:.9g}",
            rows=self.frame_shape[0],
            columns=self.frame_shape[1],
            electronics=electronics,
            baffle=self._baffle(),
            **{name: f"{value:.9g}" for name, value in vars(self).items() if name != "frame_shape"},
        )

    def _baffle(self) -> str:
        """Return the shape that keeps light from going straight from source to detector; none if that stands nearer to the object."""
        x, z = self.source_m
        if z >= self.detector_distance_m:
            return ""
        place = (1.0 - BAFFLE_PLACE) * x, z + BAFFLE_PLACE * (self.detector_distance_m - z)
        return _BAFFLE.format(half=f"{0.5 * BAFFLE_SIZE * place[0]:.9g}", x=f"{place[0]:.9g}", z=f"{place[1]:.9g}")


_ROUGH = """<bsdf type="phase_screen">
            <float name="height_rms" value="2e-6"/>
            <float name="correlation_length" value="10e-6"/>"""

_WALL = f"""{_ROUGH}
            <bsdf type="diffuse"><spectrum name="reflectance" value="{{wall_albedo}}"/></bsdf>
        </bsdf>"""

_BAFFLE = """
    <!-- keeps light from going straight from the virtual source to the virtual detector -->
    <shape type="rectangle" id="baffle">
        <transform name="to_world">
            <scale x="{half}" y="{half}"/>
            <translate x="{x}" z="{z}"/>
        </transform>
        <bsdf type="diffuse"><spectrum name="reflectance" value="0"/></bsdf>
    </shape>
"""

_SCENE = f"""<?xml version="1.0" encoding="utf-8"?>
<!-- SI units. The hidden object lies in the origin and faces +z. -D exposure=0.5 sets a parameter of the first lines. -->
<scene version="3.0.0">
    <default name="exposure" value="{{exposure_s}}"/>
    <default name="power" value="{{power_w}}"/>
    <default name="albedo" value={{albedo}}/>    <!-- power reflectance of the object; white is 1 -->

    <integrator type="speckle"/>

    <emitter type="laser" id="laser">
        <float name="wavelength" value="{{wavelength_m}}"/>
        <float name="power" value="$power"/>
        <float name="spot_diameter" value="{{spot_diameter_m}}"/>
        <transform name="to_world"><lookat origin="{{laser}}" target="{{source}}" up="0, 1, 0"/></transform>
    </emitter>

    <!-- the wall that the laser lights -->
    <shape type="rectangle" id="virtual_source">
        <transform name="to_world">
            <scale x="{{source_half}}" y="{{source_half}}"/>
            <lookat origin="{{source}}" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        {_WALL}
    </shape>

    <shape type="rectangle" id="hidden_object">
        <transform name="to_world">
            <scale x="{{half_width}}" y="{{half_height}}"/>
            <rotate z="1" angle="180"/>
        </transform>
        {_ROUGH}
            <bsdf type="diffuse">
                <texture type="bitmap" name="reflectance">
                    <string name="filename" value="$albedo"/>
                    <boolean name="raw" value="true"/>
                    <string name="filter_type" value="nearest"/>
                    <string name="wrap_mode" value="clamp"/>
                </texture>
            </bsdf>
        </bsdf>
    </shape>

    <!-- the wall that the camera photographs -->
    <shape type="rectangle" id="virtual_detector">
        <transform name="to_world">
            <scale x="{{detector_half}}" y="{{detector_half}}"/>
            <rotate y="1" angle="180"/>
            <translate z="{{detector_distance_m}}"/>
        </transform>
        {_WALL}
        <sensor type="speckle_camera">
            <float name="pixel_pitch" value="{{pixel_pitch_m}}"/>
            <float name="magnification" value="{{magnification}}"/>
            <float name="pupil_diameter" value="{{pupil}}"/>
            <float name="exposure" value="$exposure"/>{{electronics}}
            <transform name="to_world">
                <lookat origin="{{camera}}" target="0, 0, 0" up="0, 1, 0"/>
                <translate z="{{detector_distance_m}}"/>
            </transform>
            <film type="hdrfilm">
                <integer name="width" value="{{columns}}"/>
                <integer name="height" value="{{rows}}"/>
                <string name="pixel_format" value="luminance"/>
                <string name="component_format" value="float32"/>
            </film>
        </sensor>
    </shape>
{{baffle}}</scene>
"""
