"""`python -m benchmarks.cameras -o FOLDER`: compare predicted exposures with those actually needed, for random cameras.

Each camera photographs the reference scene. The prediction is that of `python -m radiometry.plan corner_letter --cameras --correlation`.
Captures are rendered at several exposures around it and reconstructed. The exposures at which the mean detection exceeds its limit and
the mean correlation exceeds the value asked for are interpolated. `cameras.json` holds them, `cameras.png` shows them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

import correlograph as cg
from correlograph.commands.required_error import RequiredError
from correlograph.files.figures import save_figure
from invert.measure.estimate import estimate_from_frames
from invert.measure.spectrum import read_measurement
from radiometry.camera_choice import Arrangement, compare_cameras
from radiometry.cameras import Camera
from radiometry.noise.detection import DETECTION_LIMIT
from radiometry.prediction import predict
from sim.plan import check, check_sampling
from sim.rendering import render_geometry
from sim.scene import load

FACTORS = (0.7, 1.0, 1.4)
"""Exposures in units of the predicted one."""

FRAMES = 2


def draw_camera(number: int, geometry: Any) -> tuple[Camera, Arrangement]:
    """Return a random camera and an arrangement whose pixels sample the object's fringes."""
    rng = np.random.default_rng([number, 11])
    while True:
        shape = (int(rng.integers(768, 2305)), int(rng.integers(768, 2305)))
        camera = Camera(
            f"camera {number}",
            float(rng.uniform(2.4e-6, 11e-6)),
            shape,
            float(rng.uniform(0.0, 3.0)),
            float(rng.uniform(0.0, 2.0)),
            20000.0,
            bool(rng.integers(2)),
            ((532e-9, float(rng.uniform(0.4, 0.95))),),
        )
        choice = Arrangement(float(rng.choice([1.0, 0.5, 0.25])), int(rng.choice([1, 2])), float(rng.uniform(0.02, 0.06)))
        try:
            check_sampling(choice.apply(geometry, camera))
        except cg.InputError:
            continue
        return camera, choice


def crossing(seconds: list[float], values: list[float], level: float) -> float:
    """Return the exposure at which a power law through the values equals a level."""
    slope, offset = np.polyfit(np.log(seconds), np.log(values), 1)
    return float(np.exp((np.log(level) - offset) / slope))


def measure_detection(capture: cg.Capture, truth: cg.Truth, quality: str, seed: int) -> float:
    return read_measurement(estimate_from_frames(capture).values).detection


def measure_correlation(capture: cg.Capture, truth: cg.Truth, quality: str, seed: int) -> float:
    result = cg.reconstruct(capture, quality=quality, seed=seed)
    return result.compare(truth).pearson if result.object_found else 0.0


def exposure_reaching(
    measure: Callable[..., float], geometry: Any, predicted_s: float, level: float, captures: int, quality: str
) -> float:
    """Return the total exposure (sum over all frames) at which the mean of a measure reaches a level."""
    exposures, means = [], []
    for step, factor in enumerate(FACTORS):
        seconds = predicted_s * factor
        seen = geometry.with_exposure(seconds / FRAMES)
        prediction = predict(seen)
        truth = cg.Truth(prediction.cells, prediction.pitches_m)
        capture_of = partial(render_geometry, seen, FRAMES)
        values = [measure(capture_of(100 * step + number), truth, quality, number) for number in range(captures)]
        exposures.append(seconds)
        means.append(float(np.mean(values)))
    return crossing(exposures, means, level)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--captures", type=int, default=8, help="captures at each exposure")
    parser.add_argument("--correlation", type=float, default=0.9)
    parser.add_argument("--quality", default="balanced")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/cameras"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    file = options.output / "cameras.json"
    rows: list[dict[str, Any]] = json.loads(file.read_text()) if file.exists() else []
    geometry = load("corner_letter").geometry
    required = RequiredError(options.correlation, FRAMES, options.quality, seed=1000)
    for number in tqdm(range(options.first + len(rows), options.first + options.count), desc="cameras"):
        camera, choice = draw_camera(number, geometry)
        plan = compare_cameras(geometry, [camera], [choice], check, FRAMES, required)[0][0]
        other = choice.apply(geometry, camera)
        detected_s = exposure_reaching(measure_detection, other, plan.detection_s, DETECTION_LIMIT, options.captures, "")
        sharp_s = exposure_reaching(
            measure_correlation, other, plan.correlation_s, options.correlation, options.captures, options.quality
        )
        rows.append(
            {
                "pixel_on_wall_um": 1e6 * other.camera.pixel_pitch_m,
                "read_noise": other.camera.electronics.read_noise,
                "lag_pitch_um": 1e6 * plan.lag_pitch_m,
                "detection_s": [plan.detection_s, detected_s],
                "correlation_s": [plan.correlation_s, sharp_s],
            }
        )
        file.write_text(json.dumps(rows, indent=1))
        print(rows[-1], flush=True)
    draw(options.output / "cameras.png", rows, options.correlation)
    for name in ("detection_s", "correlation_s"):
        ratios = np.array([row[name][1] / row[name][0] for row in rows])
        within = int((np.abs(np.log(ratios)) < np.log(1.25)).sum())
        print(f"{name}: reached over predicted {ratios.min():.2f} to {ratios.max():.2f}, {within} of {len(rows)} within 25 %")


def draw(path: Path, rows: list[dict[str, Any]], correlation: float) -> None:
    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    axes = figure.add_subplot()
    for name, label, mark in (("detection_s", "detected", "o"), ("correlation_s", f"correlation {correlation:g}", "s")):
        predicted, found = zip(*(row[name] for row in rows), strict=True)
        axes.loglog(predicted, found, mark, mfc="none", label=label)
    limits = np.array(axes.get_xlim())
    axes.fill_between(limits, limits / 1.25, limits * 1.25, color="0.9", label="within 25 %")
    axes.set_xlabel("predicted exposure (s)")
    axes.set_ylabel("reached exposure (s)")
    axes.legend(frameon=False)
    save_figure(path, figure)


if __name__ == "__main__":
    main()
