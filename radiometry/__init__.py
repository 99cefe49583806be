"""Radiometry: photons, light budget, autocorrelation estimate, and noise of the estimate.

    photons.py          photon rate, coherence area
    light_budget_rows.py  light budget, one row per factor; closed form for flat, Lambertian scenes
    autocorrelation.py  patches and their lags; effect of the patch window on r*r
    estimation/         frames -> estimate; camera and lamp artefacts; third moment
    transfer.py         H: pupil and pixel
    motion.py           reduction of the speckle by motion
    noise/              noise of the estimate: model, level, budget
    prediction.py       prediction of the estimate and its noise for a scene
    field_forecast.py   whether the fields of frames can be retrieved
    ring_correlation.py resolution: ring correlation, measured and expected
    exposure_planner.py division of an exposure into frames
    cameras.py          table of cameras, binning, efficiency
    camera_choice.py    comparison of cameras for a scene
    safety.py           laser safety of the spot
    validation/         published lab series and figures of the noise validation

This package imports nothing of the project except the basic modules of `correlograph`. `predict` and `light_budget`, which also load
scenes, are those of `sim.scene_forecast`.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim.scene_forecast import Forecast, light_budget, predict

__all__ = ["Forecast", "light_budget", "predict"]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from correlograph.version import version

        return version()
    from correlograph.lazy import load_attribute

    return load_attribute(__name__, dict.fromkeys(__all__, "sim.scene_forecast"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
