"""A loaded scene: its geometry, plan, drawing, light budget and copies with other values."""

from __future__ import annotations

import atexit
import hashlib
import tempfile
from collections.abc import Iterable, Mapping
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from correlograph.errors import InputError
from correlograph.files.figures import figure_as_html, show_figure
from correlograph.ranges import SAMPLES, SI, Range
from sim.geometry import Geometry
from sim.plan import Plan, Settings
from sim.plan_report import PlanPage
from sim.plugins import refusals
from sim.scene_file import load_scene, scene_digest
from sim.scene_reader import fingerprint, read_geometry
from sim.transport.monte_carlo import MonteCarlo, estimate_throughput

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_SWEPT = {"exposure": Geometry.with_exposure, "power": Geometry.with_power}
"""Parameters that leave the geometry of a scene unchanged."""


class Scene:
    """A loaded scene. Changes by `mi.traverse(scene.mitsuba)` affect the next `geometry` and rendering.

    Attributes:
        mitsuba: the `mi.Scene`.
        name, digest, parameters: properties of the scene file, for sim.json; the digest is empty for a scene without a file.
        sensor: index of the selected sensor; None if the scene has only one.
    """

    def __init__(
        self,
        scene: mi.Scene,
        name: str = "",
        digest: str = "",
        parameters: Mapping[str, Any] | None = None,
        sensor: int | None = None,
    ) -> None:
        if not isinstance(scene, mi.Scene):
            raise InputError("scene", "a mi.Scene", f"{scene!r:.60}", "load it with correlograph.load")
        self.mitsuba, self.name, self.digest, self.parameters = scene, name, digest, dict(parameters or {})
        self._sensor_number = sensor
        self.sensor = None if sensor is None else scene.sensors()[sensor]
        self._template: Scene | None = None
        self._changes: dict[str, float] = {}
        self._prepared: tuple[int, Geometry, dict[Settings, Plan]] | None = None

    def __repr__(self) -> str:
        values = "".join(f", {name}={value}" for name, value in self.parameters.items())
        return f"Scene({self.name or 'without a file'}{values})"

    def _repr_html_(self) -> str:
        return figure_as_html(self.draw(), repr(self))

    def __copy__(self) -> Scene:
        copied = Scene(self.mitsuba, self.name, self.digest, self.parameters, self._sensor_number)
        copied._template, copied._changes = self._template, dict(self._changes)
        return copied

    def __deepcopy__(self, memo: dict[int, Any]) -> Scene:
        make, arguments = self.__reduce__()
        return make(*arguments)

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        """Pickle the name and the parameters; the scene file is loaded again. Raises InputError for a scene without a file."""
        if not self.digest:
            found = "one that was loaded from a dictionary or by Mitsuba"
            raise InputError("scene", "a scene that was loaded from a file", found, "save it as a file and load that")
        return _load_again, (self.name, self.digest, self.parameters, self._sensor_number)

    @property
    def geometry(self) -> Geometry:
        """Distances, axes and light path in float64."""
        return self._prepare()[1]

    def draw(self) -> Figure:
        """Return the scene as a matplotlib figure, from above and from the side, to scale."""
        from sim.scene_drawing import draw_scene

        return draw_scene(self.mitsuba, self.geometry).plot(self.name or "scene")

    def show(self) -> None:
        """Open the drawing of the scene in a window, or below a notebook cell."""
        show_figure(self.draw())

    def plan(self, settings: Settings | None = None) -> Plan:
        """Return the plan; it is computed once for an unchanged scene. Raises InputError if the scene cannot be modelled."""
        _, geometry, plans = self._prepare()
        settings = Settings() if settings is None else settings
        if not isinstance(settings, Settings):
            raise InputError("settings", "a Settings", f"{settings!r:.60}", "create one with correlograph.Settings")
        if settings not in plans:
            template = self._template and self._template.plan(settings)
            plans[settings] = template.with_geometry(geometry) if template else PlanPage.of(geometry, settings)
        return plans[settings]

    def monte_carlo(self, samples: int = 2**16) -> MonteCarlo:
        """Return the light budget by path tracing. Raises InputError for too few or too many samples."""
        samples = SAMPLES.check("samples", samples)
        return estimate_throughput(self.mitsuba, samples, camera=self.sensor)

    def through(self, sensor: int) -> Scene:
        """Return the same scene seen by another of its sensors. Raises InputError for a sensor that it does not have."""
        sensor = Range(0, len(self.mitsuba.sensors()) - 1).check("sensor", sensor)
        seen = Scene(self.mitsuba, self.name, self.digest, self.parameters, sensor)
        seen._template, seen._changes = self._template and self._template.through(sensor), dict(self._changes)
        return seen

    def sweep(self, parameter: str, values: Iterable[float]) -> list[Scene]:
        """Return copies of the scene with other values of `exposure` (s) or `power` (W); the samples of the object and the
        propagator are computed once.

        The scene file must declare the parameter by `<default name="exposure" .../>`. Load the scene again for other
        parameters, because these change its geometry.

        Raises InputError for another parameter, and for values out of range.
        """
        if not isinstance(parameter, str) or parameter not in _SWEPT:
            expected = f"{' or '.join(_SWEPT)}, which leave the geometry unchanged"
            raise InputError("parameter", expected, repr(parameter), "load the scene with each value instead")
        if not isinstance(values, Iterable):
            raise InputError("values", "a list of numbers", f"{values!r:.60}", "put the value into a list")
        return [self._with_value(parameter, value) for value in values]

    def _with_value(self, parameter: str, value: float) -> Scene:
        if not isinstance(value, Real):
            raise InputError(parameter, "numbers", f"{value!r:.60}", "convert them")
        is_dark = parameter == "power" and value == 0.0
        number = 0.0 if is_dark else SI.check(parameter, value)
        given = {**self.parameters, parameter: _definition(parameter, value)}
        digest = scene_digest(self.name, given) if self.digest else ""
        other = Scene(self.mitsuba, self.name, digest, given, self._sensor_number)
        other._template = self._template or self
        other._changes = {**self._changes, parameter: number}
        return other

    def _prepare(self) -> tuple[int, Geometry, dict[Settings, Plan]]:
        state = fingerprint(self.mitsuba)
        if self._prepared is None or self._prepared[0] != state:
            geometry = read_geometry(self.mitsuba, self.sensor) if self._template is None else self._template.geometry
            for parameter, value in self._changes.items():
                geometry = _SWEPT[parameter](geometry, value)
            self._prepared = (state, geometry, {})
        return self._prepared


def _load_again(name: str, digest: str, parameters: dict[str, str], sensor: int | None) -> Scene:
    """Load a pickled scene. Raises InputError if its file has changed."""
    scene = load(name, **parameters)
    if scene.digest != digest:
        raise InputError("scene", "the file that was pickled", f"another content of {name}", "load the scene again")
    return scene if sensor is None else scene.through(sensor)


def load(scene: str | Path | dict[str, Any] | mi.Scene, /, **parameters: Any) -> Scene:
    """Load a scene.

    Args:
        scene: name of a shipped scene, scene file, dictionary as for `mi.load_dict`, or loaded scene.
        parameters: values for the scene file, as for `-D`; numpy numbers are allowed. An array (H, W) of reflectances takes the place of
            the name of a bitmap, such as `albedo`; it reads like the image.

    Raises InputError for a scene that cannot be loaded, and for parameters that it does not have.
    """
    if isinstance(scene, (dict, mi.Scene)):
        if parameters:
            raise InputError(
                "parameters", "allowed only with a scene file", ", ".join(sorted(parameters)), "edit the dictionary"
            )
        if isinstance(scene, mi.Scene):
            return Scene(scene)
        return _load_dictionary(scene)
    if not isinstance(scene, (str, Path)):
        raise InputError("scene", "a name, a file, a dictionary or a mi.Scene", f"{scene!r:.60}", "load another scene")
    given = {name: _definition(name, value) for name, value in parameters.items()}
    loaded, digest = load_scene(scene, given)
    return Scene(loaded, str(scene), digest, given)


def _check_bitmaps(content: Mapping[str, Any]) -> None:
    """Refuse a bitmap texture without an image, on which Mitsuba would end the process."""
    if content.get("type") == "bitmap" and not {"filename", "data", "bitmap"} & set(content):
        raise InputError("bitmap", "a texture with filename, data or bitmap", "none of them", "add one")
    for value in content.values():
        if isinstance(value, Mapping):
            _check_bitmaps(value)


def _load_dictionary(content: dict[str, Any]) -> Scene:
    if "type" not in content:
        raise InputError("scene", "a dictionary with a type, as for mi.load_dict", f"{content!r:.60}", "add 'type': 'scene'")
    _check_bitmaps(content)
    refusals.clear()
    try:
        return Scene(mi.load_dict(content, optimize=False))
    except Exception as error:  # Mitsuba raises bare exceptions, and wraps those of plugins in its own
        reason = " ".join(str(error).split())[-200:]
        raise (
            refusals[0] if refusals else InputError("scene", "a dictionary that Mitsuba can load", reason, "edit it")
        ) from None


def _definition(name: str, value: Any) -> str:
    """Return a parameter as the text of `-D name=value`. Raises InputError for a value that is neither text nor a number."""
    if isinstance(value, (str, Path)):
        return str(value)
    if isinstance(value, np.ndarray):
        return str(_bitmap_of(name, value))
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        raise InputError(name, "a number or a text", f"{value!r:.60}", "convert it to a number")
    return str(int(value)) if isinstance(value, Integral) else repr(float(value))


def _bitmap_of(name: str, albedo: np.ndarray) -> Path:
    """Write reflectances (H, W) to a file that lasts as long as the process, named by its content; return the file."""
    if albedo.ndim != 2 or albedo.size == 0 or albedo.dtype.kind not in "uifb":
        raise InputError(name, "an array (H, W) of reflectances", f"{albedo.dtype} {albedo.shape}", "convert it")
    pixels = np.ascontiguousarray(albedo, np.float32)
    if not (np.isfinite(pixels).all() and pixels.min() >= 0.0 and pixels.max() <= 1.0):
        raise InputError(name, "reflectances from 0 to 1", f"{pixels.min():g} to {pixels.max():g}", "divide by the maximum")
    file = _bitmap_folder() / f"{name}_{hashlib.sha256(pixels.tobytes() + str(pixels.shape).encode()).hexdigest()[:16]}.exr"
    if not file.is_file():
        mi.Bitmap(pixels[..., None]).write(str(file))
    return file


@cache
def _bitmap_folder() -> Path:
    folder = tempfile.TemporaryDirectory(prefix="correlograph-")
    atexit.register(folder.cleanup)
    return Path(folder.name)
