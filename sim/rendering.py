"""Rendering of captures in memory, and the record of a capture (sim.json)."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from correlograph.errors import check_device
from correlograph.files.capture import Capture
from correlograph.lags import LAGS, lag_grid
from correlograph.ranges import FRAMES, SEED
from correlograph.version import version
from radiometry.prediction import patches_of
from sim.frame import Simulation
from sim.geometry import Geometry
from sim.plan import Plan, Settings
from sim.plan_report import as_json
from sim.recording import Recording
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
    check_device(device)
    frames, seed = FRAMES.check("frames", frames), SEED.check("seed", seed)
    begin = time.perf_counter()
    plan = scene.plan(settings)
    content = as_json(plan, frames, scene.monte_carlo())
    prepared = time.perf_counter()
    recording = Recording(plan, seed, mean=mean, device=device, digest=scene.digest)
    capture = recording.capture(frames)
    seconds = {"prepare": prepared - begin, "render": time.perf_counter() - prepared, "write": 0.0}
    truth, pitches_m = lag_grid_albedo(plan.geometry)
    saturated = float(np.mean([recording.saturation(frame) for frame in capture.frames]))
    return replace(capture, truth=truth, record=record(scene, recording, content, pitches_m, saturated, seconds))


def render_geometry(geometry: Geometry, frames: int = 2, seed: int = 0) -> Capture:
    """Render frames of a geometry in memory, with the metadata of its camera but without truth and record."""
    return Recording(Plan.of(geometry), seed).capture(frames)


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
    check_device(device)
    seed = SEED.check("seed", seed)
    plan = scene.plan(settings)
    field = Simulation(plan.geometry, device=device, plan=plan).wall_field(seed, frame)
    return (field / np.sqrt(plan.samples.brightness)).cpu().numpy()


def record(
    scene: Scene,
    recording: Recording,
    content: dict[str, Any],
    pitches_m: tuple[float, float],
    saturated: float,
    seconds: dict[str, float],
) -> dict[str, Any]:
    """Return the content of sim.json.

    Args:
        content: the plan.
        pitches_m: lag pitches of the truth (rows, columns).
        saturated: fraction of the pixels that reached the full well.
    """
    return {
        "scene": scene.name,
        "scene_sha256": scene.digest,
        "definitions": dict(scene.parameters),
        "seed": recording.seed,
        "version": version(),
        "lag_pitch_m": pitches_m[0],
        "lag_pitches_m": list(pitches_m),
        "mean_photoelectrons_per_pixel": recording.plan.mean_photoelectrons,
        "expected_photoelectrons_only": recording.mean,
        "frames": content["frames"],
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
