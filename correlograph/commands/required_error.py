"""Error of an estimate at which reconstructions of a scene's object reach a correlation, by rendering and reconstructing it."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from correlograph.errors import InputError

if TYPE_CHECKING:
    from radiometry.prediction import Prediction

STANDARD_ERROR = 0.05
"""Standard error of the natural logarithm of the exposure at which sampling stops."""

MIN_SAMPLES, MAX_SAMPLES = 32, 120
"""Number of reconstructions near the solution. With fewer, a slope that is too steep by chance ends the sampling too early."""

SPREAD = 0.4
"""Exposures are sampled this far below and above the present solution, as natural logarithms."""

MAX_OCTAVES = 12
"""Maximum distance of the solution from the first exposure."""

MAX_SIDE = 1400
"""Maximum rows and columns of the rendered frames; larger frames are cropped. The error accounts for their K."""


class RequiredError:
    """Error of an estimate at which reconstructions of the scene's object have a correlation on average.

    It is found once for all cameras whose lag pitches agree within 15 % and whose transfers H agree within 5 %.
    """

    def __init__(self, correlation: float, frames: int, quality: str, seed: int = 0) -> None:
        self.correlation, self.frames, self.quality, self.seed = correlation, frames, quality, seed
        self._known: dict[tuple[int, int], float] = {}

    def __call__(self, geometry: Any, prediction: Prediction) -> float:
        """Return the error for a camera. Raises InputError for an object that is wider than 64 lags or cannot be detected,
        or a correlation that its reconstructions cannot reach.
        """
        if not prediction.cells.any():
            raise InputError("--correlation", "an object as wide as 64 lags or narrower", "a wider one", "omit --correlation")
        transfer = float(prediction.signal.sum() / (prediction.signal / prediction.transfer).sum())
        key = round(5.0 * math.log2(prediction.pitch_m)), round(20.0 * transfer)
        if key not in self._known:
            self._known[key] = self._find(geometry)
        return self._known[key]

    def _find(self, geometry: Any) -> float:
        from tqdm import tqdm

        from correlograph import Truth, reconstruct
        from radiometry.prediction import predict
        from sim.rendering import render_geometry

        rows, columns = (min(side, MAX_SIDE) for side in geometry.camera.frame_shape)
        cropped = geometry.with_camera(frame_shape=(rows, columns))
        prediction = predict(cropped)
        truth = Truth(prediction.cells, prediction.pitches_m)
        with tqdm(desc=f"reconstructions, {1e6 * prediction.pitch_m:.0f} um", unit="image", disable=None) as bar:

            def correlation_at(exposure_s: float, seed: int) -> float:
                capture = render_geometry(cropped.with_exposure(exposure_s), self.frames, seed)
                result = reconstruct(capture, quality=self.quality, seed=seed)
                bar.update()
                return result.compare(truth).pearson if result.object_found else 0.0

            detected = prediction.detection_exposure_s(self.frames)
            if detected is None:
                raise InputError("--correlation", "an object that can be detected", "none", "omit --correlation")
            exposure_s = solve(correlation_at, self.correlation, 4.0 * detected, self.seed)
        error = prediction.at_exposure(exposure_s).error(self.frames)
        assert error is not None
        return error


def solve(sample: Callable[[float, int], float], level: float, start: float, seed: int = 0) -> float:
    """Return the positive argument at which the mean of a noisy, increasing function has a level.

    Args:
        sample: called with an argument and a seed that is used once.
        start: where the search begins.

    Raises InputError if the level is not passed within `MAX_OCTAVES`.
    """
    seeds = count(seed)
    octaves, step = 0.0, -1.0 if sample(start, next(seeds)) > level else 1.0
    while (sample(start * 2.0 ** (octaves + step), next(seeds)) > level) == (step < 0.0):
        octaves += step
        if abs(octaves) >= MAX_OCTAVES:
            remedy = "ask for another correlation, or for more frames"
            raise InputError("--correlation", "one that the reconstruction can reach", f"{level:g}", remedy)
    solution = math.log(start) + (octaves + 0.5 * step) * math.log(2.0)
    tried: list[float] = []
    found: list[float] = []
    while len(tried) < MAX_SAMPLES:
        for offset in (-SPREAD, SPREAD):
            tried.append(solution + offset)
            found.append(sample(math.exp(tried[-1]), next(seeds)))
        if len(tried) >= MIN_SAMPLES:
            solution, uncertainty = _intersect(np.array(tried), np.array(found), level)
            if uncertainty < STANDARD_ERROR:
                break
    return math.exp(solution)


def _intersect(tried: np.ndarray, found: np.ndarray, level: float) -> tuple[float, float]:
    """Return where a straight line through samples crosses a level, and the standard error of that position."""
    (slope, offset), residual, *_ = np.polyfit(tried, found, 1, full=True)
    slope = max(slope, 0.02)
    deviation = math.sqrt(float(residual[0]) / (len(tried) - 2)) if len(residual) else 0.0
    solution = float(np.clip((level - offset) / slope, tried.min() - SPREAD, tried.max() + SPREAD))
    return solution, deviation / slope / math.sqrt(len(tried))
