"""`correlograph COMMAND ...`: every command under one name."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

from correlograph.command import ArgumentParser, run_command
from correlograph.version import version

COMMANDS = {
    "new-scene": ("correlograph.commands.new_scene", "write a scene round a corner from a picture and a few numbers"),
    "sim": ("sim.__main__", "render speckle frames of a scene, or print the plan"),
    "radiometry": ("correlograph.commands.light_budget", "print the light budget and the noise of a scene"),
    "plan": ("correlograph.commands.exposure_plan", "divide an exposure into frames, or compare cameras"),
    "validate": ("correlograph.commands.noise_validation", "compare the noise model with rendered and lab speckle"),
    "invert": ("invert.__main__", "reconstruct hidden objects from frames or autocorrelations"),
    "track": ("invert.track", "track a moving object, with the laser at rest"),
    "live": ("correlograph.commands.live", "follow a running camera on a local page"),
    "data-gen": ("data_gen.__main__", "generate a dataset of targets and measurements"),
    "preview": ("data_gen.preview", "plot a contact sheet of a dataset"),
    "letters": ("data_gen.letters", "write characters as albedo bitmaps or meshes"),
    "mesh": ("sim.mesh", "convert a mesh to PLY in metres for a scene"),
    "train": ("invert.training.train", "train a network"),
    "warm-starts": ("invert.training.warm_starts", "precompute classical reconstructions for training"),
    "calibrate": ("invert.training.calibration", "calibrate the confidence of a network"),
    "evaluate": ("invert.evaluation.evaluate", "compare methods on test sets"),
    "doctor": ("correlograph.doctor", "list missing components and the features that they affect"),
}
"""Module and purpose of each command."""


class _PrintCompletion(argparse.Action):
    """Print a completion script. It needs the options of every command, so it imports all of them."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: object, values: object, option: str | None = None) -> None:
        import shtab

        print(shtab.complete(_build_parser(options=True), shell=str(values)))
        parser.exit()


def _build_parser(*, options: bool = False) -> ArgumentParser:
    """Build the parser of the command names; with `options`, that of their options as well."""
    p = ArgumentParser(
        prog="correlograph",
        description="Render speckle from hidden objects and reconstruct the objects from it.",
        epilog="'correlograph COMMAND --help' lists the options of a command.",
    )
    p.add_argument("--version", action="version", version=f"correlograph {version()}")
    p.add_argument(
        "--print-completion",
        action=_PrintCompletion,
        choices=("bash", "zsh", "tcsh"),
        help="print a completion script for a shell",
    )
    subparsers = p.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (module, purpose) in COMMANDS.items():
        parents = [import_module(module).parser()] if options else []
        for parent in parents:
            parent.add_help = False
        subparsers.add_parser(name, help=purpose, parents=parents, add_help=False, conflict_handler="resolve")
    return p


def dispatch(argv: Sequence[str] | None = None) -> None:
    """Run the command that the first argument names."""
    arguments = sys.argv[1:] if argv is None else list(argv)
    first = arguments[:1] if arguments and not arguments[0].startswith("-") else arguments
    command = _build_parser().parse_args(first).command
    module = import_module(COMMANDS[command][0])
    module.main(arguments[1:])


def main() -> None:
    """Console entry point."""
    run_command(dispatch)
