"""Public API of the simulator: load a scene, render captures of it, compute the field on the wall."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import torch

from correlograph.errors import InputError, check_device
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.frames import FrameHeader
from correlograph.ranges import FRAMES, SEED
from correlograph.version import version
from radiometry.prediction import patches_of
from sim.frame import Simulation
from sim.geometry import Geometry
from sim.plan import Plan, Settings
from sim.plan_report import as_json
from sim.scene_file import load_scene
from sim.scene_reader import fingerprint, read_geometry
from sim.transport.monte_carlo import MonteCarlo, estimate_throughput


class Scene:
    """A loaded scene. What `mi.traverse(scene.mitsuba)` changes shows in the next `geometry` and rendering.

    Attributes:
        mitsuba: the `mi.Scene`.
        name, digest, parameters: for the record; the digest is empty for a scene that came from no file.
        sensor: the one in use; None for the only one.
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
        self.sensor = None if sensor is None else scene.sensors()[sensor]
        self._prepared: tuple[int, Geometry, dict[Settings, Plan]] | None = None

    @property
    def geometry(self) -> Geometry:
        return self._prepare()[1]

    def plan(self, settings: Settings | None = None) -> Plan:
        """What is modelled and how; decided once for a scene that has not changed. InputError where it cannot be modelled."""
        _, geometry, plans = self._prepare()
        settings = settings or Settings()
        if settings not in plans:
            plans[settings] = Plan.of(geometry, settings)
        return plans[settings]

    def monte_carlo(self, samples: int = 2**16) -> MonteCarlo:
        """Light budget by path tracing, beside the plan's."""
        return estimate_throughput(self.mitsuba, samples, camera=self.sensor)

    def through(self, sensor: int) -> Scene:
        """The same scene seen by another of its sensors."""
        return Scene(self.mitsuba, self.name, self.digest, self.parameters, sensor)

    def _prepare(self) -> tuple[int, Geometry, dict[Settings, Plan]]:
        state = fingerprint(self.mitsuba)
        if self._prepared is None or self._prepared[0] != state:
            self._prepared = (state, read_geometry(self.mitsuba, self.sensor), {})
        return self._prepared


def load(scene: str | Path | dict[str, Any] | mi.Scene, /, **parameters: Any) -> Scene:
    """Load a scene.

    Args:
        scene: the name of a shipped scene, a scene file, a dictionary as for `mi.load_dict`, or a loaded scene.
        parameters: of the scene file, as `-D` takes them; numbers are numbers.

    Raises InputError for a scene that cannot be loaded, and for parameters that it does not have.
    """
    if isinstance(scene, (dict, mi.Scene)):
        if parameters:
            raise InputError("parameters", "none for a scene that is no file", sorted(parameters), "set them in the scene")
        if isinstance(scene, mi.Scene):
            return Scene(scene)
        return Scene(mi.load_dict(scene, optimize=False))
    from scenes import scene_path

    path = Path(scene)
    if not path.is_file() and scene_path(str(scene)).is_file():
        path = scene_path(str(scene))
    given = {
        name: value if isinstance(value, str) else repr(value) if isinstance(value, float) else str(value)
        for name, value in parameters.items()
    }
    loaded, digest = load_scene(path, given)
    return Scene(loaded, str(scene), digest, given)


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
        frames: number of frames, each with an illumination of its own.
        mean: expected photoelectrons, before any noise.

    Raises InputError where the scene cannot be modelled as the settings ask.
    """
    scene = scene if isinstance(scene, Scene) else load(scene)
    _check(frames, seed, device)
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
    """Complex field on the virtual detector, (H, W), its mean square 1 on average; complex128 where a kernel in double
    precision was chosen."""
    scene = scene if isinstance(scene, Scene) else load(scene)
    _check(1, seed, device)
    plan = scene.plan(settings)
    field = Simulation(plan.geometry, device=device, plan=plan).wall_field(seed, frame)
    return (field / np.sqrt(plan.samples.brightness)).cpu().numpy()


def draw(plan: Plan, frames: int, seed: int, *, mean: bool = False, device: str = "cpu") -> Iterator[np.ndarray]:
    """Frames one after the other, float32 (H, W)."""
    simulation = Simulation(plan.geometry, device=device, plan=plan)
    for number in range(frames):
        frame: torch.Tensor = simulation.expected_frame(seed, number) if mean else simulation.frame(seed, number)
        yield frame.numpy()


def header(plan: Plan, seed: int, number: int, digest: str) -> FrameHeader:
    """Header of a frame's file."""
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
    """What sim.json holds."""
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
    """The hidden object's albedo on the lag grid of patches of `patch` pixels (None: as `invert` chooses).

    (64, 64) float32, and the pitches down and right.
    """
    _, pitches_m = patches_of(geometry, patch)
    return geometry.hidden_object.sample(pitches_m, (64, 64)).albedo, pitches_m


def saturation(plan: Plan, frames: list[np.ndarray]) -> float:
    """Share of the pixels at the full well."""
    full_well = plan.geometry.electronics.full_well
    return float(np.mean([(frame >= full_well).mean() for frame in frames])) if full_well else 0.0


def _check(frames: int, seed: int, device: str) -> None:
    FRAMES.check("frames", frames)
    SEED.check("seed", seed)
    check_device(device)
