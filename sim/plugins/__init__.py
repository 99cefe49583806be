"""Mitsuba plugins of the scene vocabulary, registered for the active variant."""

from collections.abc import Callable
from typing import Any

import mitsuba as mi

from correlograph.errors import InputError

refusals: list[InputError] = []
"""What plugins refused since the list was last cleared: Mitsuba passes on the text of an exception, not the exception."""


def record_refusals(plugin: Callable[[mi.Properties], Any]) -> Callable[[mi.Properties], Any]:
    """A plugin whose refusals are kept for whoever loads the scene."""

    def make(props: mi.Properties) -> Any:
        try:
            return plugin(props)
        except InputError as error:
            refusals.append(error)
            raise

    return make


def register_plugins() -> None:
    """Make `laser`, `phase_screen` and `speckle_camera` known to Mitsuba."""
    from sim.plugins.laser import Laser
    from sim.plugins.phase_screen import PhaseScreen
    from sim.plugins.speckle_camera import SpeckleCamera

    mi.register_emitter("laser", record_refusals(Laser))
    mi.register_bsdf("phase_screen", record_refusals(PhaseScreen))
    mi.register_sensor("speckle_camera", record_refusals(SpeckleCamera))
