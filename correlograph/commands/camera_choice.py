"""`python -m radiometry.plan SCENE --cameras`: compare cameras for a scene, as a table and a figure, best first."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from correlograph.command import ArgumentParser
from correlograph.commands.required_error import RequiredError
from correlograph.ranges import CONFIDENCE, FRAMES, SI, WAVELENGTH, Range

SHOWN = 3
"""Lines of each camera that the terminal shows; the files hold all."""


def add_options(p: ArgumentParser) -> None:
    group = p.add_argument_group("comparison of cameras")
    group.add_argument(
        "--cameras",
        nargs="?",
        const="",
        metavar="CSV",
        help="compare the cameras of a table; without a file, of the shipped one",
    )
    group.add_argument(
        "--magnification", type=SI, nargs="+", default=[1.0, 0.5, 0.25], help="magnifications to try (1 0.5 0.25)"
    )
    group.add_argument("--binning", type=Range(1, 64), nargs="+", default=[1, 2], help="on-chip binnings to try (1 2)")
    group.add_argument("--pupil-m", type=SI, nargs="+", default=[None], help="pupil diameters to try; else that of the scene")
    group.add_argument("--wavelength-m", type=WAVELENGTH, nargs="+", default=[None], help="wavelengths to try")
    group.add_argument("--power-w", type=SI, nargs="+", default=[None], help="laser powers to try")
    group.add_argument("--frames", type=FRAMES, default=2, help="frames that share the exposure (2)")
    group.add_argument(
        "--correlation", type=CONFIDENCE, help="also predict the exposure at which the reconstruction reaches this correlation"
    )
    group.add_argument(
        "--quality", choices=("fast", "balanced", "best"), default="balanced", help="quality of that reconstruction"
    )


def compare(options: Any, geometry: Any, folder: Path | None) -> None:
    """Compare the cameras, print the best arrangements of each, and save all."""
    from radiometry.camera_choice import arrangements, compare_cameras
    from radiometry.cameras import TABLE, read_cameras
    from sim.plan import check

    cameras = read_cameras(Path(options.cameras) if options.cameras else TABLE)
    choices = arrangements(options.magnification, options.binning, options.pupil_m, options.wavelength_m, options.power_w)
    required = None
    if options.correlation is not None:
        required = RequiredError(options.correlation, options.frames, options.quality, options.seed)
    plans, impossible = compare_cameras(geometry, cameras, choices, check, options.frames, required)
    print_table(plans, options.correlation)
    if impossible:
        print(f"{len(impossible)} combinations are impossible, for example {impossible[0]}")
    if folder is not None:
        from correlograph.files.output import save_json

        content = {"frames": options.frames, "correlation": options.correlation}
        save_json(folder / "cameras.json", {**content, "plans": [asdict(plan) for plan in plans], "impossible": impossible})
        draw(folder / "cameras.png", plans, options.correlation)
        print(folder / "cameras.png")


def print_table(plans: list[Any], correlation: float | None) -> None:
    """Print the best settings (magnification, binning, pupil, wavelength, power) of each camera, shortest exposure first."""
    aim = "" if correlation is None else f"{f'to {correlation:g}':>10}"
    print(
        f"{'camera':32} {'magn.':>6} {'bin':>3} {'e/pixel':>8} {'floor':>8} {'K':>6} {'lag':>7} {'seen':>12} {'detected':>10} "
        f"{'fields':>10}{aim}"
    )
    shown: dict[str, int] = {}
    for plan in plans:
        shown[plan.camera] = shown.get(plan.camera, 0) + 1
        if shown[plan.camera] > SHOWN:
            continue
        choice = plan.arrangement
        others = "".join(
            f", {name} {value:.3g} {unit}"
            for name, value, unit in (
                ("pupil", choice.pupil_diameter_m, "m"),
                ("wavelength", choice.wavelength_m, "m"),
                ("power", choice.power_w, "W"),
            )
            if value is not None
        )
        seen = f"{1e3 * plan.field_m[0]:.3g}x{1e3 * plan.field_m[1]:.3g} mm"
        reached = "" if correlation is None else f"{duration(plan.correlation_s):>10}"
        warning = f"  {100 * plan.saturated:.2g} % saturated" if plan.saturated > 1e-4 else ""
        print(
            f"{plan.camera:32} {choice.magnification:6.3g} {choice.binning:3} {plan.photoelectrons:8.3g} {plan.floor_over_peak:8.3g} "
            f"{plan.dof:6.0f} {1e6 * plan.lag_pitch_m:4.0f} um {seen:>12} {duration(plan.detection_s):>10} "
            f"{duration(plan.fields_s):>10}{reached}{others}{warning}"
        )


def duration(seconds: float | None) -> str:
    return "never" if seconds is None else f"{seconds:.2g} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"


def draw(path: Path, plans: list[Any], correlation: float | None) -> None:
    """Plot the exposure that each camera needs with its best magnification, binning, pupil, wavelength and power, shortest
    on top.
    """
    from matplotlib.figure import Figure

    from correlograph.files.figures import save_figure

    best = {plan.camera: plan for plan in reversed(plans)}
    ranked = sorted(best.values(), key=lambda plan: plan.rank, reverse=True)
    figure = Figure(figsize=(7.5, 1.2 + 0.42 * len(ranked)), layout="constrained")
    axes = figure.add_subplot()
    names = [
        f"{plan.camera}\nmagnification {plan.arrangement.magnification:g}, binning {plan.arrangement.binning}"
        for plan in ranked
    ]
    series = [("detected", [plan.detection_s for plan in ranked], "o")]
    if correlation is not None:
        series.append((f"correlation {correlation:g}", [plan.correlation_s for plan in ranked], "s"))
    for label, values, mark in series:
        known = [(value, row) for row, value in enumerate(values) if value is not None]
        axes.plot([value for value, _ in known], [row for _, row in known], mark, label=label)
    axes.set_yticks(range(len(ranked)), names, fontsize=7)
    axes.set_xscale("log")
    axes.grid(axis="both", alpha=0.3)
    axes.set_xlabel("exposure of all frames together (s)")
    axes.legend(frameon=False)
    save_figure(path, figure)
