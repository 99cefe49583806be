"""`python -m radiometry`: light budget of a scene in closed form and by Monte Carlo, noise, laser safety."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Any

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError
from correlograph.ranges import FRAMES, SAMPLES, SEED


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m radiometry", description="Light budget and noise of a scene.")
    p.add_argument("scene", help="Mitsuba scene file (XML), or the name of a shipped scene")
    p.add_argument("-D", dest="definitions", action="append", default=[], metavar="key=value", help="scene parameter")
    p.add_argument("--frames", type=FRAMES, default=2, help="frames of the capture, for the degrees of freedom")
    p.add_argument("--samples", type=SAMPLES, default=2**20, help="light paths of the Monte Carlo estimate")
    p.add_argument("--seed", type=SEED, default=0)
    p.add_argument("--json", action="store_true", help="print JSON")
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Load the scene, compute the account, print it."""
    options = parser().parse_args(argv)
    from sim.backend.variant import log_to_standard_error
    from sim.scene_file import load_scene, parse_definitions
    from sim.scene_reader import read_geometry

    log_to_standard_error()
    scene, _ = load_scene(options.scene, parse_definitions(options.definitions))
    geometry = read_geometry(scene)
    account = scene_account(scene, geometry, options.frames, options.samples, options.seed)
    for warning in account["warnings"]:
        print(f"warning: {warning}", file=sys.stderr)
    print(json.dumps(account, indent=2, allow_nan=False) if options.json else as_text(account))


def scene_account(scene: Any, geometry: Any, frames: int, samples: int, seed: int) -> dict[str, Any]:
    """Return everything that the command prints, for JSON; docs/radiometry.md describes the keys."""
    from radiometry.light_budget_rows import closed_form, light_budget
    from radiometry.safety import spot_safety
    from sim.plan import Plan
    from sim.plan_report import warnings_of
    from sim.transport.monte_carlo import estimate_throughput

    path = geometry.light_path
    plan = Plan.of(geometry)
    prediction = plan.prediction
    if frames == prediction.grid.count == 1:
        raise InputError("--frames", "two or more, because the frame holds a single patch", frames, "increase --frames")
    safety = None
    if 400e-9 <= path.wavelength_m <= 700e-9:
        safety = spot_safety(path.power_w, path.wavelength_m, geometry.spot.diameter_m, path.source_albedo)
    monte_carlo = estimate_throughput(scene, samples, seed)
    return {
        **light_budget(path).as_dict(),
        "closed_form_per_frame_db": closed_form(path).as_dict()["per_frame_db"],
        "monte_carlo": monte_carlo.as_dict(),
        "other_light_share": geometry.other_light_share,
        "shot_floor_over_peak": prediction.shot_floor_over_peak,
        "floor_over_peak": prediction.shot_floor_over_peak,  # old name
        "dof": prediction.dof(frames),
        "noise_over_peak": prediction.terms.over_peak(),
        "signal_to_noise": prediction.signal_to_noise(frames),
        "photoelectrons_per_pixel": prediction.terms.light.signal,
        "exposure_s": geometry.camera.electronics.exposure_s,
        "safety": safety,
        "warnings": warnings_of(plan, frames, monte_carlo),
    }


def as_text(account: dict[str, Any]) -> str:
    """Return the account as a table."""

    def db(value: float | None) -> str:
        return "dark" if value is None else f"{value:9.2f} dB"

    monte_carlo = account["monte_carlo"]
    low, high = monte_carlo["interval_db"]
    lines = [f"{row['name']:<40}{db(row['db'])}" for row in account["rows"]]
    lines += [
        f"{'per pixel':<40}{db(account['per_pixel_db'])}",
        f"{'per frame':<40}{db(account['per_frame_db'])}",
        f"{'per frame, closed form (flat, Lambertian)':<40}{db(account['closed_form_per_frame_db'])}",
        f"{'per frame, Monte Carlo':<40}{db(monte_carlo['per_frame_db'])}  (95 %: {db(low).strip()} to {db(high).strip()})",
        f"{'light by other ways, over the object':<40}{account['other_light_share']:9.2g}",
        f"{'photoelectrons per second and frame':<40}{account['photoelectrons_per_frame_s']:9.3g}",
        f"{'photoelectrons per pixel':<40}{account['photoelectrons_per_pixel']:9.3g}  in {account['exposure_s']:g} s",
        "floor over peak: "
        + (
            ", ".join(f"{name.replace('_', ' ')} {share:.3g}" for name, share in account["noise_over_peak"].items() if share)
            or "no signal"
        ),
        f"degrees of freedom K {account['dof']:.3g}, mean signal to noise "
        + (f"{account['signal_to_noise']:.3g}" if account["signal_to_noise"] is not None else "none"),
    ]
    safety = account["safety"]
    if safety is None:
        lines.append("laser safety: not visible light; look the limit up in IEC 60825-1")
    else:
        lines.append(
            f"laser safety (IEC 60825-1, visible, 0.25 s): spot {safety['spot_w_per_m2']:.3g} W/m^2, "
            f"{safety['spot_over_limit']:.3g} times the limit of {safety['limit_w_per_m2']:.3g}; "
            f"its diffuse light is safe beyond {safety['hazard_distance_m'] * 100:.2g} cm"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    run_command(main)
