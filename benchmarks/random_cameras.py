"""`python -m benchmarks.random_cameras -o FOLDER --cameras 60`: predicted noise and signal of random cameras against rendered frames.

Every camera has a random pixel pitch, frame, exposure and number of frames; each stage of the sensor, motion, linewidth, depolarisation and
lamp is on or off at random. Floor over peak, peak and K of `CAPTURES` rendered captures are compared with the prediction.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import correlograph as cg
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
from radiometry.noise.measured_noise import fit_known_signal, read_noise_level
from radiometry.prediction import Prediction, predict
from sim.frame import Simulation
from sim.plan import Settings, check

CAPTURES = 4

SCENES = ("corner_letter", "tilted_letter", "two_depths", "strong_ambient")

MAX_FLOOR = 30.0
"""Largest floor over peak, and MAX_GRAINS the most grains of motion, at which a signal remains to be compared."""

MAX_GRAINS = 3.0


def draw_camera(number: int) -> tuple[dict[str, Any], Any, int]:
    """Return description, geometry and number of frames of random camera `number`."""
    rng = np.random.default_rng([number, 44])
    scene = str(rng.choice(SCENES))
    geometry = cg.load(scene).geometry

    def sometimes(value: float, probability: float = 0.4) -> float:
        return float(value) if rng.random() < probability else 0.0

    scale = float(rng.uniform(0.8, 1.8))
    rows, columns = (int(side) for side in rng.integers(420, 900, 2))
    exposure_s = float(2.0 ** rng.uniform(-6.0, 0.0))
    photons = predict(geometry).terms.light.signal / geometry.camera.electronics.exposure_s * exposure_s * scale**2
    electronics = replace(
        geometry.camera.electronics,
        exposure_s=exposure_s,
        quantum_efficiency=1.0,
        read_noise=sometimes(rng.uniform(0.05, 1.0)),
        dark_current=sometimes(rng.uniform(0.05, 2.0)),
        fixed_pattern=sometimes(rng.uniform(0.05, 1.5)),
        **({"full_well": max(40.0 * photons, 10.0), "bits": int(rng.integers(7, 13))} if rng.random() < 0.4 else {}),
        **({"gate": exposure_s / int(rng.integers(2, 2000))} if rng.random() < 0.3 else {}),
    )
    geometry = geometry.with_camera(
        pixel_pitch_m=scale * geometry.camera.pixel_pitch_m, frame_shape=(rows, columns), electronics=electronics
    )
    grain_m = geometry.wavelength_m * geometry.distance_m / max(geometry.hidden_object.extent_m)
    scan_speed = sometimes(rng.uniform(0.1, MAX_GRAINS) * geometry.spot.diameter_m / exposure_s, 0.3)
    velocity = np.array([1.0, 0.5, 0.0]) * sometimes(rng.uniform(0.1, MAX_GRAINS) * grain_m / 3.0 / exposure_s, 0.2)
    linewidth = sometimes(10.0 ** rng.uniform(9.0, 10.7), 0.3)
    geometry = replace(
        geometry,
        spot=replace(geometry.spot, scan_speed_m_s=scan_speed, linewidth_hz=linewidth),
        is_depolarised=bool(rng.random() < 0.3),
    ).with_velocity(velocity)
    frames = int(rng.integers(1, 4))
    used = {
        name: value for name, value in vars(electronics).items() if value and name not in ("quantum_efficiency", "shot_noise")
    }
    drawn = {"scene": scene, "frames": frames, "shape": [rows, columns], "pitch": scale, **used}
    drawn |= {"scan": geometry.spot.scan_speed_m_s, "velocity": float(np.abs(velocity).max())}
    return drawn | {"linewidth_hz": geometry.spot.linewidth_hz, "depolarised": geometry.is_depolarised}, geometry, frames


def measure(geometry: Any, prediction: Prediction, frames: int, seeds: Sequence[int]) -> np.ndarray:
    """Return floor over peak, peak over the predicted one, and K of one rendered capture per seed, (seeds, 3)."""
    simulation = Simulation(geometry, Settings(effects=(("detector_roughness", True),)))
    light, found = prediction.terms.light, []
    for seed in seeds:
        seen = [simulation.frame(seed, number).numpy() for number in range(frames)]
        estimate, _ = estimate_autocorrelation(seen, prediction.grid)
        gain, floor = fit_known_signal(estimate, prediction.signal)
        shrinkage = prediction.terms.shrinkage()
        peak = light.signal**2 * light.grain_pixels / shrinkage
        found.append((floor / gain, gain / peak, read_noise_level(estimate).dof or np.nan))
    return np.array(found)


def compare(number: int, seeds: Sequence[int] = range(CAPTURES)) -> dict[str, Any]:
    """Return predicted and measured numbers of a random camera, with the deviations in standard errors and in parts of the prediction."""
    drawn, geometry, frames = draw_camera(number)
    check(geometry)
    prediction = predict(geometry)
    expected = np.array([prediction.floor_over_peak(frames) or np.inf, 1.0, prediction.dof(frames)])
    row = drawn | {"predicted": expected.tolist(), "detection": prediction.detection(frames)}
    if expected[0] > MAX_FLOOR:
        return row
    found = measure(geometry, prediction, frames, seeds)
    mean, error = found.mean(0), found.std(0, ddof=1) / len(seeds) ** 0.5
    return row | {
        "measured": mean.tolist(),
        "sigma": (np.abs(mean - expected) / error).tolist(),
        "relative": (np.abs(mean / expected - 1.0)).tolist(),
    }


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--cameras", type=int, default=60)
    options = parser.parse_args(argv)
    options.output.mkdir(parents=True, exist_ok=True)
    rows = []
    for number in range(options.cameras):
        rows.append(compare(number))
        print(number, json.dumps(rows[-1]), flush=True)
    (options.output / "random_cameras.json").write_text(json.dumps(rows, indent=1))
    compared = [row for row in rows if "measured" in row]
    for index, name in enumerate(("floor over peak", "peak", "K")):
        within = [row["sigma"][index] < 3.0 or row["relative"][index] < 0.05 for row in compared]
        print(
            f"| {name} | {sum(within)} of {len(within)} | median {np.median([row['relative'][index] for row in compared]):.3f} |"
        )


if __name__ == "__main__":
    main()
