"""Rendering of captures in memory, and the record of a capture (sim.json)."""

from __future__ import annotations

import math
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
from sim.optics.motion import moved_positions
from sim.plan import Plan, Settings
from sim.plan_report import as_json
from sim.recording import Recording
from sim.scene import Scene, load
from sim.scene_drawing import draw_scene

FINER_TRUTH = 4
"""Samples along each axis of a cell of the truth of a moving object."""


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
        "motion": motion_of(recording.plan.geometry, content["frames"]),
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


def motion_of(geometry: Geometry, frames: int) -> list[dict[str, Any]]:
    """Return, for each frame of a scene that moves, the middle of its exposure, the displacement of each hidden object along rows, columns
    and line of sight, its rotation vector along the same axes, and the displacement of the camera's view; nothing for a scene at rest.
    """
    if not geometry.moves:
        return []
    hidden, found = geometry.hidden_object, []
    turned = np.stack([hidden.axes.down, hidden.axes.right, hidden.line_of_sight])
    for number in range(frames):
        time_s = geometry.frame_middle_s(number)
        objects = []
        for one in geometry.movements:
            way = one.trajectory.displacement(time_s)
            along = [*hidden.axes.coordinates(way), way @ hidden.line_of_sight]
            turn = turned @ np.degrees(one.trajectory.rotation(time_s).as_rotvec())
            objects.append({"displacement_m": [float(part) for part in along], "rotation_deg": turn.tolist()})
        view = geometry.camera.view_shift(time_s)
        found.append({"time_s": time_s, "objects": objects, "camera_m": view.tolist()})
    return found


def moved_albedo(geometry: Geometry, time_s: float, patch: int | None = None, lags: int = LAGS) -> np.ndarray:
    """Return `lag_grid_albedo` of the hidden objects where they are at a time, (lags + 1, lags + 1) float32; without occlusion of one by
    another, and with the albedo at rest."""
    _, pitches_m = patches_of(geometry, patch, lags)
    hidden, side = geometry.hidden_object, lag_grid(lags).object_side
    finer = (pitches_m[0] / FINER_TRUTH, pitches_m[1] / FINER_TRUTH)
    shape = tuple(math.ceil(extent / step) + 1 for extent, step in zip(hidden.extent_m, finer, strict=True))
    seen = hidden.sample(finer, (shape[0], shape[1]))
    place = np.nonzero(seen.weight > 0.0)
    coordinates = np.stack([(index - 0.5 * (n - 1)) * step for index, n, step in zip(place, shape, finer, strict=True)], 1)
    moved = moved_positions(geometry, hidden.position(coordinates, seen.depth_m[place]), seen.part[place], time_s)
    nearer = 1.0 / (1.0 + moved @ hidden.line_of_sight / geometry.distance_m)  # as seen from the wall
    at = nearer[:, None] * hidden.axes.coordinates(moved) / pitches_m + 0.5 * (side - 1)
    albedo, low = np.zeros((side, side)), np.floor(at).astype(int)
    for step in ((0, 0), (0, 1), (1, 0), (1, 1)):
        cell, share = low + step, np.prod(1.0 - np.abs(at - low - step), axis=1) * seen.albedo[place] / FINER_TRUTH**2
        held = ((cell >= 0) & (cell < side)).all(1)
        np.add.at(albedo, tuple(cell[held].T), share[held])
    return albedo.astype(np.float32)
