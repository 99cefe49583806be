"""Light budget and prediction of a scene: the public functions, which also take the name of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from correlograph.errors import InputError
from correlograph.files.figures import figure_as_html
from correlograph.ranges import FRAMES, PATCH
from radiometry.light_budget_rows import Budget
from radiometry.light_budget_rows import light_budget as budget_of_path
from radiometry.prediction import predict as predict_geometry
from sim.scene import load

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Forecast:
    """Prediction of the autocorrelation estimate of a capture; `print` shows it.

    Attributes:
        signal: H (r*r), smoothed by the window, (127, 127), in units of (r*r)(0).
        floor_over_peak: noise floor in the same unit; None without light.
        dof: degrees of freedom K.
        signal_to_noise: signal-to-noise ratio of the estimate, averaged over the lags of the object; None without light.
        pitches_m: object distance of one lag along rows and columns.
        frames: number of frames.
    """

    signal: np.ndarray
    floor_over_peak: float | None
    dof: float
    signal_to_noise: float | None
    pitches_m: tuple[float, float]
    frames: int = 2

    def __repr__(self) -> str:
        floor, ratio = ("none" if value is None else f"{value:.3g}" for value in (self.floor_over_peak, self.signal_to_noise))
        rows, columns = self.signal.shape
        return (
            f"estimate of {self.frames} {'frame' if self.frames == 1 else 'frames'}: {rows} x {columns} lags of "
            f"{1e6 * self.pitches_m[0]:.0f} x {1e6 * self.pitches_m[1]:.0f} um, floor over peak {floor}, K {self.dof:.3g}, "
            f"signal to noise {ratio}"
        )

    def _repr_html_(self) -> str:
        return figure_as_html(self.plot(), repr(self))

    def plot(self) -> Figure:
        """Return the expected estimate as a matplotlib figure; the square root shows the faint lags."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(4.6, 3.8), layout="constrained")
        axes = figure.add_subplot()
        rows, columns = (0.5 * side * pitch * 1e3 for side, pitch in zip(self.signal.shape, self.pitches_m, strict=True))
        shown = np.sqrt((self.signal + (self.floor_over_peak or 0.0)).clip(0.0))
        image = axes.imshow(shown, cmap="gray", extent=(-columns, columns, rows, -rows), vmax=float(np.quantile(shown, 0.999)))
        axes.set(xlabel="lag (mm)", ylabel="lag (mm)", title="expected estimate")
        figure.colorbar(image, ax=axes, label="square root, (r*r)(0) = 1")
        return figure


def light_budget(scene: Any) -> Budget:
    """Return the light budget of a scene.

    Args:
        scene: from `correlograph.load`, its geometry, or what `load` takes.

    Raises InputError for anything else than a scene.
    """
    return budget_of_path(_geometry_of(scene).light_path)


def predict(scene: Any, frames: int = 2, patch: int | None = None) -> Forecast:
    """Predict the estimate of a capture with a number of frames and patches of `patch` pixels (None: as in `invert`).

    Raises InputError for numbers out of range, and for anything else than a scene.
    """
    frames = FRAMES.check("frames", frames)
    patch = None if patch is None else PATCH.check("patch", patch)
    known = predict_geometry(_geometry_of(scene), patch)
    return Forecast(
        known.signal, known.floor_over_peak(frames), known.dof(frames), known.signal_to_noise(frames), known.pitches_m
    )


def _geometry_of(scene: Any) -> Any:
    if isinstance(scene, (str, Path, dict)):
        scene = load(scene)
    geometry = getattr(scene, "geometry", scene)
    if not hasattr(geometry, "light_path"):
        raise InputError("scene", "a loaded scene", f"{scene!r:.60}", "load it with correlograph.load")
    return geometry
