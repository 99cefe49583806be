"""Radiometry: photons, light budget, autocorrelation estimate, and noise of the estimate.

    photons.py          photon rate, coherence area
    light_budget_rows.py  light budget, one row per factor; closed form for flat, Lambertian scenes
    scene_forecast.py     light budget and prediction of a scene: the public functions
    autocorrelation.py  patches and their lags; effect of the patch window on r*r
    estimation/         frames -> estimate; camera and lamp artefacts; third moment
    transfer.py         H: pupil and pixel
    motion.py           reduction of the speckle by motion
    noise/              noise of the estimate: model, level, budget
    prediction.py       prediction of the estimate and its noise for a scene
    exposure_planner.py division of an exposure into frames
    cameras.py          table of cameras, binning, efficiency
    camera_choice.py    comparison of cameras for a scene
    safety.py           laser safety of the spot
    validation/         published lab series and figures of the noise validation

This package imports nothing of the project except the basic modules of `correlograph`.
"""

from typing import TYPE_CHECKING, Any

import lazy_loader

if TYPE_CHECKING:
    from radiometry.scene_forecast import Forecast, light_budget, predict

__all__ = ["Forecast", "light_budget", "predict"]
_load_attribute, __dir__, _ = lazy_loader.attach(__name__, submod_attrs={"scene_forecast": __all__})


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from correlograph.version import version

        return version()
    return _load_attribute(name)
