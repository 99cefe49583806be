"""Mitsuba plugins of the scene vocabulary, registered for the active variant."""

import mitsuba as mi


def register_plugins() -> None:
    """Make `laser`, `phase_screen`, `speckle_camera`, `speckle` and `throughput` known to Mitsuba."""
    from sim.plugins.laser import Laser
    from sim.plugins.phase_screen import PhaseScreen
    from sim.plugins.speckle import Speckle
    from sim.plugins.speckle_camera import SpeckleCamera
    from sim.plugins.throughput import Throughput

    mi.register_emitter("laser", Laser)
    mi.register_bsdf("phase_screen", PhaseScreen)
    mi.register_sensor("speckle_camera", SpeckleCamera)
    mi.register_integrator("speckle", Speckle)
    mi.register_integrator("throughput", Throughput)
