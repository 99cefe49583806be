"""Rendering of captures in memory, the header of a frame, and the record of a capture."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import torch

from correlograph.errors import check_device
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.exr_frames import FrameHeader
from correlograph.files.file_metadata import rendered_metadata
from correlograph.lags import LAGS, lag_grid
from correlograph.ranges import FRAMES, SEED
from correlograph.version import version
from radiometry.prediction import patches_of
from sim.frame import Simulation
from sim.geometry import Geometry
from sim.plan import Plan, Settings
from sim.plan_report import as_json
from sim.scene import Scene, load
from sim.scene_drawing import draw_scene


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
    drawn = list(draw_frames(plan, frames, seed, mean=mean, device=device))
    seconds = {"prepare": prepared - begin, "render": time.perf_counter() - prepared, "write": 0.0}
    headers = tuple(header(plan, seed, number, scene.digest) for number in range(frames))
    truth, pitches_m = lag_grid_albedo(plan.geometry)
    entries = record(
        scene, plan, content, seed, frames, pitches_m, mean=mean, saturated=saturation(plan, drawn), seconds=seconds
    )
    names = tuple(f"frame_{number:04d}" for number in range(frames))
    written = rendered_metadata(headers[0].exposure_s)
    return Capture(drawn, CameraMetadata.of(headers[0]), names, truth, entries, headers, written)


def render_geometry(geometry: Geometry, frames: int = 2, seed: int = 0) -> Capture:
    """Render frames of a geometry in memory, with the metadata of its camera but without truth and record."""
    plan = Plan.of(geometry)
    names = tuple(f"frame_{number:04d}" for number in range(frames))
    first = header(plan, seed, 0, "")
    written = rendered_metadata(first.exposure_s)
    return Capture(list(draw_frames(plan, frames, seed)), CameraMetadata.of(first), names, file_metadata=written)


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


def draw_frames(plan: Plan, frames: int, seed: int, *, mean: bool = False, device: str = "cpu") -> Iterator[np.ndarray]:
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
        "drawing": draw_scene(scene.mitsuba, scene.geometry).as_json(),
        "seconds": seconds,
    }


def lag_grid_albedo(geometry: Geometry, patch: int | None = None, lags: int = LAGS) -> tuple[np.ndarray, tuple[float, float]]:
    """Return the albedo of the hidden object on the lag grid of patches of `patch` pixels (None: as in `invert`), and the pitches.

    The albedo is (lags + 1, lags + 1) float32; the pitches belong to rows and columns.
    """
    _, pitches_m = patches_of(geometry, patch, lags)
    side = lag_grid(lags).object_side
    return geometry.hidden_object.sample(pitches_m, (side, side)).albedo, pitches_m


def saturation(plan: Plan, frames: list[np.ndarray]) -> float:
    """Return the fraction of pixels, over all frames, that reached the full well."""
    full_well = plan.geometry.electronics.full_well
    return float(np.mean([(frame >= full_well).mean() for frame in frames])) if full_well else 0.0


def _check(frames: int, seed: int, device: str) -> tuple[int, int]:
    """Return number of frames and seed as Python integers. Raises InputError for values out of range."""
    check_device(device)
    return FRAMES.check("frames", frames), SEED.check("seed", seed)
