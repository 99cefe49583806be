"""Radiometry: photons, the light budget, frames and the autocorrelation estimate with its noise.

    photons.py          photon rates, coherence area, ideal noise floor
    throughput.py       light budget, one row a factor; its closed form for flat, Lambertian scenes
    scene_budget.py     light budget and prediction of a scene in one call
    autocorrelation.py  patches and their lags, and what a patch window does to r*r
    estimation/         frames -> estimate; faults of cameras and lamps; whether the light is speckle
    transfer.py         H: pupil and pixel
    motion.py           what motion leaves of the speckle
    noise/              noise of the estimate: model, level, budget
    prediction.py       all of these for a scene
    exposure_planner.py how to divide a photon budget (command: plan.py)
    safety.py           laser safety of the spot
    files/              frames, captures, pictures, results
    validate.py         rendered and lab noise against prediction (validation/)
    errors.py           InputError: name, expected, found, remedy
    ranges.py           ranges of numbers, for options and arguments alike
    workers.py          Dask workers, here or on a cluster
    cli.py              the `correlograph` command (doctor.py: what a machine lacks)

Everything else builds on this package; but for its commands (__main__.py, plan.py, validate.py) it imports none of the others.
"""

from typing import TYPE_CHECKING

import lazy_loader

from correlograph.version import version

if TYPE_CHECKING:
    from radiometry.scene_budget import Forecast, light_budget, predict

__all__ = ["Forecast", "light_budget", "predict"]
__version__ = version()
__getattr__, __dir__, _ = lazy_loader.attach(__name__, submod_attrs={"scene_budget": __all__})
