"""Record of the background and of the sensor faults that an estimator found in the frames."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

MeanModel = Literal["auto", "pooled", "fixed", "published"]
"""Background models of an estimator; `radiometry.estimation.autocorrelation_estimator` describes them."""

MEAN_MODELS: tuple[MeanModel, ...] = ("auto", "pooled", "fixed", "published")


@dataclass(frozen=True)
class BackgroundRecord:
    """Background and sensor faults in the frames; None for a quantity that was not estimated.

    Attributes:
        mean: background model, as `--mean-model` names it.
        frames_correlate: fraction of the spectral power of the frames that is common to all of them.
        fixed_pattern_lags: fraction of the lags at which a static background pattern was subtracted.
        shift_pixels: largest camera shift between frames along rows and columns.
        uneven_illumination: whether a non-uniform illumination was divided out.
        spectral_lines: number of sine waves that were subtracted from the frames.
        hot_pixels: number of pixels that were replaced.
        faulty_lines: number of rows and columns that were replaced.
        saturated: fraction of saturated pixels in the brightest frame.
    """

    mean: str
    frames_correlate: float | None = None
    fixed_pattern_lags: float | None = None
    shift_pixels: tuple[float, float] | None = None
    uneven_illumination: bool | None = None
    spectral_lines: int | None = None
    hot_pixels: int | None = None
    faulty_lines: int | None = None
    saturated: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the quantities that were estimated, for JSON."""
        return {name: value for name, value in asdict(self).items() if value is not None}
