"""`python -m benchmarks.tracking_cameras`: velocities of letters before random cameras, in units of their standard errors.

Distances, angles, wavelength, spot, pixels, magnification and frame are drawn, and a letter that moves at 0.5 to 8 pixels of speckle per
frame, 30 to 1000 times per second, with 0.005 to 0.3 photoelectrons per pixel. The laser is at rest. `correlograph.track` knows what a user
knows: the metadata of the camera, the distance of the spot and its angle.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import correlograph as cg
from benchmarks.tracking import LETTERS
from correlograph.commands.new_scene import main as new_scene
from scenes import scene_path
from sim.frame import Simulation
from sim.geometry import Geometry
from sim.rendering import render_geometry

FRAMES = 24

RANGES = {
    "object-width-m": (6e-3, 1.4e-2),
    "source-distance-m": (0.3, 1.2),
    "source-angle-deg": (10.0, 45.0),
    "detector-distance-m": (0.7, 2.0),
    "camera-angle-deg": (0.0, 35.0),
    "pixel-pitch-m": (2.4e-6, 5.5e-6),
    "magnification": (0.3, 1.0),
    "wavelength-m": (4e-7, 8e-7),
    "spot-diameter-m": (1e-3, 5e-3),
}
"""Ranges of the options of `correlograph new-scene`."""


def draw(number: int) -> tuple[Geometry, dict[str, float], float, np.ndarray]:
    """Return random scene `number`, its options, its frames per second, and the velocity in m/s along rows and columns, (2,)."""
    rng = np.random.default_rng([number, 4647])
    letter, sides = str(rng.choice(LETTERS)), rng.integers(450, 900, 2)
    options = {name: float(rng.uniform(*span)) for name, span in RANGES.items()}
    per_s, angle = float(10.0 ** rng.uniform(1.5, 3.0)), rng.uniform(0.0, 2.0 * np.pi)
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        picture = scene_path("corner_letter").with_name(f"{letter}.png")
        arguments = [str(picture), "-o", f"{folder}/scene", "--pixels", *map(str, sides)]
        new_scene([*arguments, *(part for name, value in options.items() for part in (f"--{name}", str(value)))])
        geometry = cg.load(Path(folder) / "scene" / "scene.xml", exposure=1.0 / per_s).geometry
    geometry = replace(geometry, spot=replace(geometry.spot, scan_step_m=0.0))
    step_pixels = rng.uniform(0.5, 8.0) * np.array([np.cos(angle), np.sin(angle)])
    velocity = np.linalg.solve(geometry.travel, step_pixels) * per_s
    axes = geometry.hidden_object.axes.coordinates(np.eye(3))
    geometry = geometry.with_velocity(np.linalg.lstsq(axes.T, velocity, rcond=None)[0])
    light = 10.0 ** rng.uniform(-2.3, -0.5) / Simulation(geometry).mean_photoelectrons
    return geometry.with_power(geometry.light_path.power_w * light), options, per_s, velocity


def measure(number: int) -> dict[str, Any]:
    """Draw, render and track one scene; what cannot be built or tracked says why."""
    try:
        geometry, options, per_s, velocity = draw(number)
    except cg.InputError as error:
        return {"number": number, "impossible": str(error)}
    capture = render_geometry(geometry, FRAMES, number)
    try:
        found = cg.track(
            capture,
            interval_s=1.0 / per_s,
            source_distance_m=options["source-distance-m"],
            source_angle_deg=(0.0, options["source-angle-deg"]),
        )
    except cg.InputError as error:
        return {"number": number, "refused": str(error)}
    assert found.velocity_m_s is not None
    assert found.velocity_error_m_s is not None
    return {
        "number": number,
        "velocity_m_s": velocity.tolist(),
        "relative_error": float(np.linalg.norm(found.velocity_m_s - velocity) / np.linalg.norm(velocity)),
        "standard_errors": ((found.velocity_m_s - velocity) / found.velocity_error_m_s).tolist(),
        "others": len(found.others),
    }


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=40, help="scenes (40)")
    parser.add_argument("--first", type=int, default=0, help="number of the first scene, which sets all random numbers (0)")
    options, deviations = parser.parse_args(argv), []
    for number in range(options.first, options.first + options.count):
        row = measure(number)
        deviations += row.get("standard_errors", [])
        print(json.dumps(row), flush=True)
    print(f"{len(deviations) // 2} of {options.count} scenes tracked")
    if deviations:
        print(
            f"rms deviation {np.sqrt(np.mean(np.square(deviations))):.2f} standard errors, largest {np.abs(deviations).max():.2f}"
        )


if __name__ == "__main__":
    main()
