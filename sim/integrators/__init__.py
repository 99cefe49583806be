"""Integrators for `mi.render`: `speckle` renders a frame, `throughput` the light budget."""

import mitsuba as mi

from sim.plugins import record_refusals


def register_integrators() -> None:
    """Register `speckle` and `throughput` with Mitsuba."""
    from sim.integrators.speckle import Speckle
    from sim.integrators.throughput import Throughput

    mi.register_integrator("speckle", record_refusals(Speckle))
    mi.register_integrator("throughput", record_refusals(Throughput))
