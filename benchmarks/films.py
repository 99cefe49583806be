"""`python -m benchmarks.films -o FOLDER`: films of a rotating letter and a walking figure against windows of frames treated as static.

Both last 4 s. Frames are rendered, each with a spot of its own. The film sees every second frame; the windows see all, and the best of them
is chosen with the truth. Correlations are those with the albedo at the middle of each image.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

import correlograph as cg
from correlograph.files.output import save_json
from data_gen.letters import letter
from invert.video.film import Film
from sim.frame import Simulation
from sim.geometry import Geometry
from sim.plan import Plan
from sim.recording import Recording

LASTS_S = 4.0
FRAMES = 64
FRAME_SHAPE = (900, 1000)
PHOTOELECTRONS = 0.1
"""Mean photoelectrons per pixel."""

SIDE = 128
"""Cells of the object along each side."""

SIDE_M = 12e-3
TURN_DEG = 120.0
HALF_WIDTHS = (1, 2, 4, 8, 16)
TIMES = 4
"""Number of times at which windows are judged."""


def rotating_letter(time_s: float) -> np.ndarray:
    """Return an R that turns by `TURN_DEG` in 4 s, (SIDE, SIDE)."""
    upright = Image.fromarray(letter("R")).resize((88, 88))
    page = Image.new("L", (SIDE, SIDE))
    page.paste(upright, (20, 20))
    return np.asarray(page.rotate(TURN_DEG * time_s / LASTS_S, Image.Resampling.BICUBIC), np.float32) / 255.0


def walking_figure(time_s: float) -> np.ndarray:
    """Return a stick figure that takes a step per second, (SIDE, SIDE)."""
    scale = 4
    page = Image.new("L", (scale * SIDE, scale * SIDE))
    pen = ImageDraw.Draw(page)
    swing = np.sin(np.pi * time_s)

    def limb(start: tuple[float, float], length: float, angle: float, bend: float) -> None:
        middle = (start[0] + 0.5 * length * np.sin(angle), start[1] + 0.5 * length * np.cos(angle))
        end = (middle[0] + 0.5 * length * np.sin(angle + bend), middle[1] + 0.5 * length * np.cos(angle + bend))
        pen.line([(scale * x, scale * y) for x, y in (start, middle, end)], fill=255, width=scale * 7, joint="curve")

    pen.ellipse([scale * side for side in (52, 12, 76, 36)], fill=255)
    limb((64.0, 34.0), 42.0, 0.0, 0.0)
    for side in (1.0, -1.0):
        limb((64.0, 76.0), 44.0, side * 0.55 * swing, -0.5 * max(0.0, -side * swing))
        limb((64.0, 44.0), 34.0, -side * 0.7 * swing, 0.5)
    return np.asarray(page.resize((SIDE, SIDE), Image.Resampling.BOX), np.float32) / 255.0


OBJECTS: dict[str, Callable[[float], np.ndarray]] = {"rotating letter": rotating_letter, "walking figure": walking_figure}


def render(object_at: Callable[[float], np.ndarray], photoelectrons: float, seed: int) -> tuple[cg.Capture, Geometry]:
    """Return the frames of an object that changes from frame to frame, and the geometry of the first."""
    scene = cg.load("corner_letter").geometry.with_camera(frame_shape=FRAME_SHAPE)
    scene = scene.with_object(object_at(0.0), SIDE_M / SIDE)
    scene = scene.with_power(scene.light_path.power_w * photoelectrons / Simulation(scene).mean_photoelectrons)
    frames = [
        Simulation(scene.with_object(object_at(time), SIDE_M / SIDE)).frame(seed, number).numpy()
        for number, time in enumerate(frame_times(FRAMES))
    ]
    return cg.Capture(frames, Recording(Plan.of(scene)).camera), scene


def frame_times(frames: int) -> np.ndarray:
    return (np.arange(frames) + 0.5) * LASTS_S / frames


def likeness(albedo: np.ndarray, truth: np.ndarray, geometry: Geometry, pitches_m: tuple[float, float]) -> float:
    """Return the correlation of an albedo with the cells of an object."""
    shown = geometry.with_object(truth, SIDE_M / SIDE).hidden_object.sample(pitches_m, albedo.shape).albedo
    return float(cg.aligned_pearson(albedo, shown.astype(np.float32))[0])


def film_scores(found: Film, object_at: Callable[[float], np.ndarray], geometry: Geometry) -> list[float]:
    """Return the correlation of each image of a film."""
    times = frame_times(FRAMES)
    every = [np.interp(2.0 * number, np.arange(FRAMES), times) for number in found.middle_frame]
    return [likeness(one, object_at(time), geometry, found.pitches_m) for one, time in zip(found.albedos, every, strict=True)]


def window_scores(
    capture: cg.Capture, object_at: Callable[[float], np.ndarray], geometry: Geometry, quality: str
) -> dict[int, list[float]]:
    """Return the correlations of windows of each half-width, treated as static, at equally spaced times."""
    times, scores = frame_times(FRAMES), {}
    for half in HALF_WIDTHS:
        row = []
        for middle in np.rint(np.linspace(16, FRAMES - 17, TIMES)).astype(int):
            part = cg.Capture(capture.frames[max(0, middle - half) : middle + half + 1], capture.camera)
            found = cg.reconstruct(part, quality=quality, blur_pixels=0.0)
            row.append(likeness(found.albedo, object_at(times[middle]), geometry, found.estimate.pitches_m))
        scores[half] = row
    return scores


def rotation_errors_deg(capture: cg.Capture) -> np.ndarray:
    """Return the errors of the angles of the rotating letter about their mean, one of each group of frames."""
    found = cg.track_rotation(capture, interval_s=LASTS_S / FRAMES)
    errors = found.angle_deg - TURN_DEG * found.middle_frame / FRAMES
    return errors - errors.mean()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--objects", nargs="+", choices=tuple(OBJECTS), default=list(OBJECTS))
    parser.add_argument("--quality", default="balanced")
    parser.add_argument("--method", default="unet", choices=("unet", "field"), help="method of the film")
    parser.add_argument("--photoelectrons", type=float, default=PHOTOELECTRONS)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rows: dict[str, Any] = {}
    for name in options.objects:
        object_at = OBJECTS[name]
        capture, geometry = render(object_at, options.photoelectrons, options.seed)
        half = cg.Capture(capture.frames[::2], capture.camera)
        interval_s = 2.0 * LASTS_S / FRAMES
        found = cg.film(half, interval_s=interval_s, quality=options.quality, method=options.method, blur_pixels=0.0)
        found.save(options.output / name.replace(" ", "_"))
        scores = film_scores(found, object_at, geometry)
        windows = window_scores(capture, object_at, geometry, options.quality)
        best = max(windows, key=lambda one: np.mean(windows[one]))
        rows[name] = {
            "images": len(scores),
            "frames_per_image": found.frames_per_image,
            "film_mean": round(float(np.mean(scores)), 3),
            "film_least": round(min(scores), 3),
            "windows_mean": {half: round(float(np.mean(row)), 3) for half, row in windows.items()},
            "best_window": best,
            "best_window_mean": round(float(np.mean(windows[best])), 3),
            "best_window_least": round(min(windows[best]), 3),
            "notes": found.notes,
        }
        if object_at is rotating_letter:
            errors = rotation_errors_deg(capture)
            rows[name] |= {
                "angle_rms_deg": round(float(errors.std()), 3),
                "angle_largest_deg": round(float(np.abs(errors).max()), 3),
            }
        print(name, json.dumps(rows[name]), flush=True)
    save_json(options.output / "films.json", rows)


if __name__ == "__main__":
    main()
