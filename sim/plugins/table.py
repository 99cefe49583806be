"""`python -m sim.plugins.table`: list every parameter of every plugin with unit, default and range, for docs/parameters.md."""

from __future__ import annotations

from sim.plugins.laser import PARAMETERS as LASER
from sim.plugins.parameters import Parameter
from sim.plugins.phase_screen import PARAMETERS as PHASE_SCREEN
from sim.plugins.speckle_camera import ELECTRONIC, OPTICAL

PLUGINS = {"laser": LASER, "phase_screen": PHASE_SCREEN, "speckle_camera": (*OPTICAL, *ELECTRONIC)}


def table() -> str:
    """Return the table of all numeric parameters, which `mi.traverse` reads and changes."""
    lines = [
        "# Parameters of the plugins",
        "",
        "Written by `python -m sim.plugins.table`. SI units throughout; each can be read and changed by `mi.traverse`.",
        "",
        "| plugin | parameter | unit | default | range |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| `{plugin}` | `{known.name}` | {known.unit or 'none'} | {_default(known)} | {_range(known)} |"
        for plugin, parameters in PLUGINS.items()
        for known in parameters
    ]
    return "\n".join(lines) + "\n"


def _default(known: Parameter) -> str:
    return "required" if known.default is None else f"{known.default:g}"


def _range(known: Parameter) -> str:
    return f"{'0, or ' if known.zero else ''}{known.low:g} to {known.high:g}"


if __name__ == "__main__":
    print(table(), end="")
