"""`correlograph sim|radiometry|invert ...`: the module commands under one name."""

from __future__ import annotations

import sys
from importlib import import_module

from radiometry.errors import InputError, run_command

COMMANDS = {
    "sim": "sim.__main__",
    "radiometry": "radiometry.__main__",
    "plan": "radiometry.plan",
    "validate": "radiometry.validate",
    "invert": "invert.__main__",
    "data-gen": "data_gen.__main__",
    "preview": "data_gen.preview",
    "letters": "data_gen.letters",
    "mesh": "sim.mesh",
    "train": "invert.train",
    "warm-starts": "invert.warm_starts",
    "calibrate": "invert.calibrate",
    "evaluate": "invert.evaluate",
    "doctor": "radiometry.doctor",
}


def _dispatch(argv: list[str] | None = None) -> None:
    arguments = sys.argv[1:] if argv is None else list(argv)
    if not arguments or arguments[0] not in COMMANDS:
        raise InputError("command", f"correlograph {'|'.join(COMMANDS)}", arguments[:1] or "none",
                         "add --help after a command for its options")
    import_module(COMMANDS[arguments[0]]).main(arguments[1:])


def main() -> None:
    """Console entry point."""
    run_command(_dispatch)
