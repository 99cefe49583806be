"""Selection of the fastest propagator within the tolerance."""

from __future__ import annotations

import math

from correlograph.errors import InputError
from sim.propagation.kernels import KERNELS
from sim.propagation.option import Option, Task


def options(task: Task, wanted: str | None = None) -> list[Option]:
    """Return the propagators for a task, fastest first.

    Args:
        wanted: name of a single propagator; None for all; `auto` ends the list with the first propagator within the
            tolerance if predicting the error of the next, slower one takes longer than running the first.
    """
    found: list[Option] = []
    for name, kernel in KERNELS.items():
        if wanted not in (None, "auto", name) or (kernel.on_lattice and task.leaves_lattice):
            continue
        within = [option for option in found if option.predicted_error <= task.tolerance]
        if wanted == "auto" and any(
            KERNELS[option.propagator].on_lattice or option.seconds < kernel.planning_seconds for option in within
        ):
            continue
        found += kernel.predict(task)
    return sorted(found, key=lambda option: option.seconds)


def choose(listed: list[Option], propagator: str, tolerance: float) -> Option:
    """Return the fastest option within the tolerance, or, if a propagator is forced, the most accurate of its options.

    Raises InputError if none is available.
    """
    if propagator != "auto":
        listed = [option for option in listed if option.propagator == propagator and math.isfinite(option.seconds)]
        if not listed:
            raise InputError("--propagator", "one that the scene and --precision allow", propagator, "use auto or direct")
    within = [option for option in listed if option.predicted_error <= tolerance]
    if not within and propagator == "auto":
        best = min(option.predicted_error for option in listed)
        raise InputError("--tolerance", f"{best:.2g} or more", tolerance, "raise it or leave --precision out")
    return within[0] if within else min(listed, key=lambda option: option.predicted_error)
