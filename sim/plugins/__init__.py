"""Mitsuba plugins of the scene vocabulary, registered for the active variant."""

from collections.abc import Callable
from typing import Any

import mitsuba as mi

from correlograph.errors import InputError

refusals: list[InputError] = []
"""Errors of plugins since the list was last cleared; Mitsuba passes on only the text of an exception."""


def record_refusals(plugin: Callable[[mi.Properties], Any]) -> Callable[[mi.Properties], Any]:
    """Wrap a plugin so that the loader of the scene can report its InputErrors instead of Mitsuba's message."""

    def make(props: mi.Properties) -> Any:
        try:
            return plugin(props)
        except InputError as error:
            refusals.append(error)
            # The traceback keeps the refused plugin alive, and Dr.Jit would call it in every later scene.
            raise error.with_traceback(None) from None

    return make


def register_plugins() -> None:
    """Register `laser`, `phase_screen` and `speckle_camera` with Mitsuba."""
    from sim.plugins.laser import Laser
    from sim.plugins.phase_screen import PhaseScreen
    from sim.plugins.speckle_camera import SpeckleCamera

    mi.register_emitter("laser", record_refusals(Laser))
    mi.register_bsdf("phase_screen", record_refusals(PhaseScreen))
    mi.register_sensor("speckle_camera", record_refusals(SpeckleCamera))
