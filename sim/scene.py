"""Public interface of the simulator: load a scene, render captures of it, compute the field on the virtual detector."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np
import torch

from correlograph.errors import InputError, check_device
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.figures import figure_as_html, show_figure
from correlograph.files.frames import FrameHeader
from correlograph.ranges import FRAMES, SEED, SI
from correlograph.version import version
from radiometry.prediction import patches_of
from sim.frame import Simulation
from sim.geometry import Geometry
from sim.plan import Plan, Settings
from sim.plan_report import as_json
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
        name, digest, parameters: for the record; the digest is empty for a scene without a file.
        sensor: the selected one; None for the only one.
    """

    def __init__(
        self,
        scene: mi.Scene,
        name: str = "",
        digest: str = "",
        parameters: Mapping[str, Any] | None = None,
        sensor: int | None = None,
    ) -> None:
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

        return draw_scene(self.mitsuba, self.geometry, self.name)

    def show(self) -> None:
        """Open the drawing of the scene in a window, or below a notebook cell."""
        show_figure(self.draw())

    def plan(self, settings: Settings | None = None) -> Plan:
        """Return the plan; it is computed once for an unchanged scene. Raises InputError if the scene cannot be modelled."""
        _, geometry, plans = self._prepare()
        settings = settings or Settings()
        if settings not in plans:
            template = self._template and self._template.plan(settings)
            plans[settings] = template.with_geometry(geometry) if template else Plan.of(geometry, settings)
        return plans[settings]

    def monte_carlo(self, samples: int = 2**16) -> MonteCarlo:
        """Return the light budget by path tracing."""
        return estimate_throughput(self.mitsuba, samples, camera=self.sensor)

    def through(self, sensor: int) -> Scene:
        """Return the same scene seen by another of its sensors."""
        seen = Scene(self.mitsuba, self.name, self.digest, self.parameters, sensor)
        seen._template, seen._changes = self._template and self._template.through(sensor), dict(self._changes)
        return seen

    def sweep(self, parameter: str, values: Iterable[float]) -> list[Scene]:
        """Return copies of the scene with other values of `exposure` (s) or `power` (W); they share one set-up.

        Load the scene again for other parameters, because these change its geometry.

        Raises InputError for another parameter, and for values out of range.
        """
        if parameter not in _SWEPT:
            expected = f"{' or '.join(_SWEPT)}, which leave the geometry unchanged"
            raise InputError("parameter", expected, repr(parameter), "load the scene with each value instead")
        return [self._with_value(parameter, SI.check(parameter, value)) for value in values]

    def _with_value(self, parameter: str, value: float) -> Scene:
        given = {**self.parameters, parameter: _definition(parameter, value)}
        digest = scene_digest(self.name, given) if self.digest else ""
        other = Scene(self.mitsuba, self.name, digest, given, self._sensor_number)
        other._template = self._template or self
        other._changes = {**self._changes, parameter: value}
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
        parameters: values for the scene file, as for `-D`; numpy numbers are allowed.

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
    given = {name: _definition(name, value) for name, value in parameters.items()}
    loaded, digest = load_scene(scene, given)
    return Scene(loaded, str(scene), digest, given)


def _load_dictionary(content: dict[str, Any]) -> Scene:
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
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        raise InputError(name, "a number or a text", f"{value!r:.60}", "convert it to a number")
    return str(int(value)) if isinstance(value, Integral) else repr(float(value))


def render(
    scene: Scene | str | Path | dict[str, Any] | mi.Scene,
    frames: int = 2,
    seed: int = 0,
    *,
    settings: Settings | None = None,
    mean: bool = False,
    device: str = "cpu",
) -> Capture:
    """Render a capture in memory; `Capture.save` writes it.

    Args:
        frames: number of frames, each with an independent illumination.
        mean: whether to render expected photoelectrons, without photon and camera noise.

    Raises InputError if the scene cannot be modelled with these settings.
    """
    scene = scene if isinstance(scene, Scene) else load(scene)
    frames, seed = _check(frames, seed, device)
    begin = time.perf_counter()
    plan = scene.plan(settings)
    content = as_json(plan, frames, scene.monte_carlo())
    prepared = time.perf_counter()
    drawn = list(draw(plan, frames, seed, mean=mean, device=device))
    seconds = {"prepare": prepared - begin, "render": time.perf_counter() - prepared, "write": 0.0}
    headers = tuple(header(plan, seed, number, scene.digest) for number in range(frames))
    truth, pitches_m = lag_grid_albedo(plan.geometry)
    entries = record(
        scene, plan, content, seed, frames, pitches_m, mean=mean, saturated=saturation(plan, drawn), seconds=seconds
    )
    names = tuple(f"frame_{number:04d}" for number in range(frames))
    return Capture(drawn, CameraMetadata.of(headers[0]), names, truth, entries, headers)


def render_geometry(geometry: Geometry, frames: int = 2, seed: int = 0) -> Capture:
    """Render frames of a geometry in memory, with the metadata of its camera but without truth and record."""
    plan = Plan.of(geometry)
    names = tuple(f"frame_{number:04d}" for number in range(frames))
    return Capture(list(draw(plan, frames, seed)), CameraMetadata.of(header(plan, seed, 0, "")), names)


def wall_field(
    scene: Scene | str | Path | dict[str, Any] | mi.Scene,
    seed: int = 0,
    frame: int = 0,
    *,
    settings: Settings | None = None,
    device: str = "cpu",
) -> np.ndarray:
    """Return the complex field on the virtual detector, (H, W), mean square 1 on average; complex128 for a propagator in
    double precision."""
    scene = scene if isinstance(scene, Scene) else load(scene)
    _, seed = _check(1, seed, device)
    plan = scene.plan(settings)
    field = Simulation(plan.geometry, device=device, plan=plan).wall_field(seed, frame)
    return (field / np.sqrt(plan.samples.brightness)).cpu().numpy()


def draw(plan: Plan, frames: int, seed: int, *, mean: bool = False, device: str = "cpu") -> Iterator[np.ndarray]:
    """Yield frames, float32 (H, W)."""
    simulation = Simulation(plan.geometry, device=device, plan=plan)
    for number in range(frames):
        frame: torch.Tensor = simulation.expected_frame(seed, number) if mean else simulation.frame(seed, number)
        yield frame.numpy()


def header(plan: Plan, seed: int, number: int, digest: str) -> FrameHeader:
    """Return the header of a frame file."""
    geometry = plan.geometry
    return FrameHeader(
        geometry.wavelength_m,
        geometry.pixel_pitch_m,
        geometry.distance_m,
        geometry.electronics.exposure_s,
        seed,
        number,
        digest,
        version(),
        geometry.pupil_diameter_m,
        geometry.pupil_distance_m,
        *geometry.seen_pitch_m,
    )


def record(
    scene: Scene,
    plan: Plan,
    content: dict[str, Any],
    seed: int,
    frames: int,
    pitches_m: tuple[float, float],
    *,
    mean: bool,
    saturated: float,
    seconds: dict[str, float],
) -> dict[str, Any]:
    """Return the content of sim.json."""
    return {
        "scene": scene.name,
        "scene_sha256": scene.digest,
        "definitions": dict(scene.parameters),
        "seed": seed,
        "version": version(),
        "lag_pitch_m": pitches_m[0],
        "lag_pitches_m": list(pitches_m),
        "mean_photoelectrons_per_pixel": plan.mean_photoelectrons,
        "expected_photoelectrons_only": mean,
        "frames": frames,
        "saturated_fraction": saturated,
        "plan": content,
        "seconds": seconds,
    }


def lag_grid_albedo(geometry: Geometry, patch: int | None = None) -> tuple[np.ndarray, tuple[float, float]]:
    """Return the albedo of the hidden object on the lag grid of patches of `patch` pixels (None: as in `invert`), and the pitches.

    The albedo is (64, 64) float32; the pitches belong to rows and columns.
    """
    _, pitches_m = patches_of(geometry, patch)
    return geometry.hidden_object.sample(pitches_m, (64, 64)).albedo, pitches_m


def saturation(plan: Plan, frames: list[np.ndarray]) -> float:
    """Return the fraction of the pixels at the full well."""
    full_well = plan.geometry.electronics.full_well
    return float(np.mean([(frame >= full_well).mean() for frame in frames])) if full_well else 0.0


def _check(frames: int, seed: int, device: str) -> tuple[int, int]:
    """Return number of frames and seed as Python integers. Raises InputError for values out of range."""
    check_device(device)
    return FRAMES.check("frames", frames), SEED.check("seed", seed)
