"""`python -m sim.plugins.table`: list every parameter of every plugin with unit, default and range, for docs/parameters.md."""

from __future__ import annotations

from sim.backend.variant import activate_variant

activate_variant()  # plugins can be imported only after a Mitsuba variant is set
from sim.plugins.laser import PARAMETERS as LASER  # noqa: E402
from sim.plugins.parameters import Parameter  # noqa: E402
from sim.plugins.phase_screen import PARAMETERS as PHASE_SCREEN  # noqa: E402
from sim.plugins.speckle_camera import ELECTRONIC, OPTICAL  # noqa: E402

OTHERS = (
    "| `laser` | `scan_step` | metres of the wall between frames | the spot's diameter or more | 0 to 1e+15 |",
    "| `phase_screen` | `depolarising` | true or false | false | |",
    *(
        line
        for plugin in ("phase_screen", "speckle_camera")
        for line in (
            f"| `{plugin}` | `velocity` | metres per second, vector | 0, 0, 0 | below the speed of light |",
            f"| `{plugin}` | `trajectory` | CSV file of positions over time | none | |",
        )
    ),
    "| `phase_screen` | `angular_velocity` | degrees per second, vector along the axis | 0, 0, 0 | finite |",
)
"""Optional and non-numeric parameters, which `mi.traverse` does not list."""

PLUGINS = {"laser": LASER, "phase_screen": PHASE_SCREEN, "speckle_camera": (*OPTICAL, *ELECTRONIC)}


def table() -> str:
    """Return the table of all parameters."""
    lines = [
        "# Parameters of the plugins",
        "",
        f"Written by `python -m sim.plugins.table`. SI units throughout. `mi.traverse` reads and changes all but the last {len(OTHERS)}.",
        "",
        "| plugin | parameter | unit | default | range |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| `{plugin}` | `{known.name}` | {known.unit or 'none'} | {_default(known)} | {_range(known)} |"
        for plugin, parameters in PLUGINS.items()
        for known in parameters
    ]
    return "\n".join([*lines, *OTHERS]) + "\n"


def _default(known: Parameter) -> str:
    return "required" if known.default is None else f"{known.default:g}"


def _range(known: Parameter) -> str:
    return f"{'0, or ' if known.zero else ''}{known.low:g} to {known.high:g}"


if __name__ == "__main__":
    print(table(), end="")
