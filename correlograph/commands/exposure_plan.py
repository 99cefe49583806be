"""`python -m radiometry.plan`: divide an exposure into frames, or compare cameras; plot the prediction and check it by rendering."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from correlograph.command import ArgumentParser, run_command
from correlograph.commands.camera_choice import add_options, compare
from correlograph.errors import InputError
from correlograph.ranges import SEED, SI, Range


def parser() -> ArgumentParser:
    p = ArgumentParser(
        prog="python -m radiometry.plan", description="Divide a photon budget into frames and patches, or compare cameras."
    )
    p.add_argument("scene", help="Mitsuba scene file (XML), or the name of a shipped scene")
    p.add_argument(
        "-D",
        dest="definitions",
        action="append",
        default=[],
        metavar="key=value",
        help="set a parameter of the scene file; may be repeated",
    )
    p.add_argument("--budget-s", type=SI, help="total exposure in seconds, which is divided into frames")
    p.add_argument(
        "--fields-m",
        type=SI,
        help="half-period in metres that the fields of --method field must resolve: fewest frames and shortest exposure",
    )
    p.add_argument(
        "--moving",
        action="store_true",
        help="the object moves and the laser is at rest: exposure, frames and groups that follow it, within --budget-s",
    )
    p.add_argument("--resolution-m", type=SI, default=300e-6, help="required lag pitch on the object in metres (300e-6)")
    p.add_argument(
        "--check",
        type=Range(0, 10**6),
        default=0,
        metavar="FRAMES",
        help="render every division into at most FRAMES frames and measure the error of its estimate",
    )
    p.add_argument("--seed", type=SEED, default=0, help="seed of rendered frames (0)")
    p.add_argument("-o", "--output", help="folder for JSON and figure; nothing is written without it")
    add_options(p)
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Load the scene and divide an exposure, plan one for fields or for a moving object, or compare cameras."""
    options = parser().parse_args(argv)
    aims = {"--budget-s": options.budget_s, "--fields-m": options.fields_m, "--cameras": options.cameras}
    given = [name for name, value in aims.items() if value is not None]
    if len(given) != 1:
        raise InputError(
            "arguments", "--budget-s SECONDS, --fields-m METRES or --cameras", " and ".join(given) or "none", "choose one"
        )
    if options.moving and (options.budget_s is None or options.check):
        raise InputError("--moving", "--budget-s SECONDS, without --check", "another aim", "give --budget-s alone")
    from correlograph.files.manifest import claim
    from correlograph.files.output import output_folder
    from sim.backend.variant import log_to_standard_error
    from sim.plan import check
    from sim.scene_file import load_scene, parse_definitions
    from sim.scene_reader import read_geometry

    folder = None if options.output is None else output_folder(options.output)
    if folder is not None:
        name = "plan" if options.cameras is None else "cameras"
        claim(folder, [f"{name}.json"] + ([] if options.moving else [f"{name}.png"]), overwrite=options.overwrite)
    log_to_standard_error()
    scene, _ = load_scene(options.scene, parse_definitions(options.definitions))
    geometry = read_geometry(scene)
    check(geometry)
    if options.cameras is not None:
        compare(options, geometry, folder)
    elif options.moving:
        follow_object(options, geometry, folder)
    else:
        divide_exposure(options, geometry, folder)


def divide_exposure(options: Any, geometry: Any, folder: Path | None) -> None:
    """Predict the error of every division, select the best or the one for fields, check it by rendering if asked, plot the curve."""
    from correlograph.files.output import save_json
    from radiometry.exposure_planner import best, divide, divide_for_fields
    from sim.plan import Plan
    from sim.plan_report import warnings_of

    if options.fields_m is None:
        divisions = divide(geometry, options.budget_s, options.resolution_m)
        chosen = best(divisions)
    else:
        chosen = divide_for_fields(geometry, options.fields_m)
        divisions = divide(geometry, chosen.frames * chosen.exposure_s, chosen.pitch_m)
    checked = render_errors(geometry, [d for d in divisions if d.frames <= options.check], options.seed)
    print(
        f"{chosen.frames} frames of {chosen.exposure_s:.4g} s, each in {chosen.patches} patches of {chosen.patch} pixels "
        f"({chosen.pitch_m * 1e6:.0f} um per lag): floor over peak {chosen.floor_over_peak:.3g}, K {chosen.dof:.3g}, "
        f"error of the estimate {100 * chosen.error:.3g} %"
    )
    warnings = warnings_of(Plan.of(geometry.with_exposure(chosen.exposure_s)), chosen.frames)
    print_warnings(warnings)
    if chosen.fields is not None:
        print(f"--method field: {chosen.fields.describe()}")
    if folder is None:
        return
    content = {
        "budget_s": options.budget_s or chosen.frames * chosen.exposure_s,
        "chosen": asdict(chosen),
        "divisions": [asdict(division) for division in divisions],
        "warnings": warnings,
        "rendered_error": {str(frames): error for frames, error in checked.items()},
    }
    save_json(folder / "plan.json", content)
    draw(folder / "plan.png", divisions, chosen, checked)
    print(folder / "plan.png")


def print_warnings(warnings: Sequence[str]) -> None:
    """Print warnings about a scene, one on a line."""
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)


def follow_object(options: Any, geometry: Any, folder: Path | None) -> None:
    """Plan the frames of a moving object, and write the plan."""
    from correlograph.files.output import save_json
    from radiometry.motion_plan import plan_motion
    from radiometry.prediction import predict
    from sim.scene_warnings import camera_warnings

    plan = plan_motion(geometry, options.budget_s)
    print(plan.describe())
    warnings = camera_warnings(predict(geometry.at_rest).at_exposure(plan.exposure_s))
    print_warnings(warnings)
    if folder is not None:
        save_json(folder / "plan.json", asdict(plan) | {"warnings": warnings})
        print(folder / "plan.json")


def render_errors(geometry: Any, divisions: list[Any], seed: int) -> dict[int, float]:
    """Render the frames of each division of the exposure and measure the error of its estimate against the known r*r."""
    from tqdm import tqdm

    from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator
    from radiometry.exposure_planner import measured_error
    from radiometry.prediction import predict
    from sim.frame import Simulation

    errors = {}
    if not divisions:
        return errors
    prediction = predict(geometry, divisions[0].patch)  # all divisions have the same patch size
    with tqdm(total=sum(d.frames for d in divisions), desc="frames", unit="frame", disable=None) as bar:
        for division in divisions:
            simulation = Simulation(geometry.with_exposure(division.exposure_s))
            estimator = AutocorrelationEstimator(prediction.grid)
            for number in range(division.frames):
                estimator.add(simulation.frame(seed, number))
                bar.update()
            errors[division.frames] = measured_error(estimator.estimate(), prediction)
    return errors


def draw(path: Path, divisions: list[Any], chosen: Any, checked: dict[int, float]) -> None:
    """Plot the error against the number of frames, up to ten times the lowest error."""
    from matplotlib.figure import Figure

    from correlograph.files.figures import save_figure

    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.add_subplot()
    shown = [d for d in divisions if d.error < 10.0 * chosen.error]
    axes.loglog([d.frames for d in shown], [100 * d.error for d in shown], "k-", label="predicted")
    if checked:
        axes.loglog(list(checked), [100 * error for error in checked.values()], "o", mfc="none", label="rendered and measured")
    axes.axvline(chosen.frames, color="0.6", lw=1, label=f"chosen: {chosen.frames} frames of {chosen.exposure_s:.3g} s")
    axes.set_xlabel("frames that share the budget")
    axes.set_ylabel("relative error of the estimate (%)")
    axes.legend(frameon=False)
    save_figure(path, figure)


if __name__ == "__main__":
    run_command(main)
