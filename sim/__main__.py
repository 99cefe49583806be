"""`python -m sim`: render speckle frames of a scene file, or print the plan."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError, check_device
from correlograph.lags import LAGS
from correlograph.ranges import FRAMES, LAG_COUNT, PATCH, SEED, SI

KERNELS = ("fraunhofer", "fresnel", "nufft", "direct")
SATURATION_WORTH_A_WARNING = 1e-3
HELD_WORTH_A_WARNING = 0.95
"""Fraction of the object, by albedo times area, that the truth of each frame should hold."""


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m sim", description="Render speckle frames of a hidden object.")
    p.add_argument("scene", help="Mitsuba scene file (XML), or the name of a shipped scene")
    p.add_argument(
        "-o", "--output", help="folder for frame_0000.exr..., truth.npy (truth_frames.npy of a scene that moves) and sim.json"
    )
    p.add_argument(
        "-D",
        dest="definitions",
        action="append",
        default=[],
        metavar="key=value",
        help="set a parameter of the scene file; may be repeated",
    )
    p.add_argument("--frames", type=FRAMES, default=2, help="number of frames to render (2)")
    p.add_argument("--seed", type=SEED, default=0, help="seed of all random numbers (0)")
    p.add_argument(
        "--plan",
        action="store_true",
        help="print the modelled effects and predictions and render nothing: a page on a terminal, JSON elsewhere; "
        "with -o, draw the scene as plan.png",
    )
    p.add_argument("--json", action="store_true", help="print the plan as JSON, also on a terminal")
    p.add_argument(
        "--truth-patch",
        type=PATCH,
        metavar="PIXELS",
        help="sample truth.npy at the lag pitch of this patch size, for 'invert --patch' (default: 300 um per lag)",
    )
    p.add_argument("--truth-lags", type=LAG_COUNT, default=LAGS, help="largest lag of truth.npy, for 'invert --lags' (63)")
    p.add_argument(
        "--noise-free",
        "--mean",
        dest="noise_free",
        action="store_true",
        help="write expected photoelectrons: speckle without photon and camera noise",
    )
    p.add_argument(
        "--accuracy",
        choices=("statistical", "field"),
        default="statistical",
        help="quantity to which --tolerance applies: the expected autocorrelation (statistical) or the complex field of each frame (field)",
    )
    p.add_argument(
        "--propagator", choices=("auto", *KERNELS), default="auto", help="auto: the fastest one within the tolerance"
    )
    p.add_argument("--tolerance", type=SI, default=1e-2, help="maximum relative error of the propagation (0.01)")
    p.add_argument(
        "--precision",
        choices=("float32", "float64"),
        help="floating-point precision of the propagation (default: chosen for the tolerance)",
    )
    p.add_argument(
        "--effect",
        dest="effects",
        action="append",
        default=[],
        metavar="NAME=on|off|auto",
        help="force an effect on or off; auto lets the plan decide; --plan lists the names",
    )
    p.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="processor of the propagation (cpu)")
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Load the scene, plan, render, write."""
    options = parser().parse_args(argv)
    _check(options)
    from correlograph.progress import stage

    with stage("loading"):
        from sim import activate

        activate()
    from sim.backend.variant import log_to_standard_error
    from sim.effects import parse_effects
    from sim.plan import Settings
    from sim.plan_report import as_json, summary
    from sim.scene import load
    from sim.scene_file import parse_definitions

    log_to_standard_error()
    with stage("planning"):
        scene = load(options.scene, **parse_definitions(options.definitions))
        plan = scene.plan(
            Settings(options.accuracy, options.tolerance, options.propagator, options.precision, parse_effects(options.effects))
        )
        monte_carlo = scene.monte_carlo()
        content = as_json(plan, options.frames, monte_carlo)
    if options.plan:
        if options.output is not None:
            _draw_plan(scene, options.output, overwrite=options.overwrite)
        if sys.stdout.isatty() and not options.json:
            print(summary(plan, options.frames, monte_carlo))
            return
        print(json.dumps(content, indent=2, allow_nan=False))
        return
    for warning in content["warnings"]:
        print(f"warning: {warning}", file=sys.stderr)
    _render(scene, plan, content, options)


def _draw_plan(scene, output: str, *, overwrite: bool) -> None:
    from correlograph.files.figures import save_figure
    from correlograph.files.manifest import claim
    from correlograph.files.output import output_folder

    path = output_folder(output) / "plan.png"
    claim(path.parent, [path.name], overwrite=overwrite)
    save_figure(path, scene.draw())
    print(f"drawing of the scene: {path}", file=sys.stderr)


def _check(options) -> None:
    if options.output is None and not options.plan:
        raise InputError("-o", "an output folder", "none", "add -o DIR, or --plan to render nothing")
    check_device(options.device)


def _render(scene, plan, content, options) -> None:
    """Render each frame into a hidden folder, then move all frames at once, so that a stopped run leaves an earlier
    capture intact."""
    import numpy as np
    from tqdm import tqdm

    from correlograph.files.capture_folder import MOVED_TRUTH, frame_path, replace_capture, stage_capture
    from correlograph.files.exr_frames import write_frame
    from correlograph.files.output import output_folder, save_array, save_json
    from sim.recording import Recording
    from sim.rendering import lag_grid_albedo, moved_albedo, record

    folder = output_folder(options.output)
    begin = time.perf_counter()
    truth, pitches_m = lag_grid_albedo(plan.geometry, options.truth_patch, options.truth_lags)
    write_s = saturated = 0.0
    with stage_capture(folder, options.frames, overwrite=options.overwrite) as staging:
        recording = Recording(plan, options.seed, mean=options.noise_free, device=options.device, digest=scene.digest)
        drawn, prepared = recording.frames(options.frames), time.perf_counter()
        for number, frame in enumerate(tqdm(drawn, total=options.frames, desc="frames", unit="frame", disable=None)):
            started = time.perf_counter()
            write_frame(frame_path(staging, number), frame, recording.header(number))
            saturated += recording.saturation(frame) / options.frames
            write_s += time.perf_counter() - started
        seconds = {"prepare": prepared - begin, "render": time.perf_counter() - prepared - write_s, "write": write_s}
        save_array(staging / "truth.npy", truth)
        if plan.geometry.moves:
            times = map(plan.geometry.frame_middle_s, range(options.frames))
            moved = [moved_albedo(plan.geometry, time, options.truth_patch, options.truth_lags) for time in times]
            save_array(staging / MOVED_TRUTH, np.stack(moved))
            held = np.sum(moved, (1, 2)) / truth.sum() if truth.any() else np.ones(1)
        save_json(staging / "sim.json", record(scene, recording, content, pitches_m, saturated, seconds))
        replace_capture(staging, folder)
    if saturated > SATURATION_WORTH_A_WARNING:
        print(f"warning: saturation: {100 * saturated:.3g} % of the pixels have their largest value", file=sys.stderr)
    if plan.geometry.moves and held.min() < HELD_WORTH_A_WARNING:
        outside = f"{100.0 * (1.0 - held.min()):.0f} % of the object is outside in frame {held.argmin()}"
        print(
            f"warning: {MOVED_TRUTH}: {outside}; --truth-lags and --truth-patch choose the lags that it holds", file=sys.stderr
        )
    print(f"{options.frames} {'frame' if options.frames == 1 else 'frames'}, {time.perf_counter() - begin:.1f} s: {folder}")


if __name__ == "__main__":
    run_command(main)
