"""A measurement on fewer lags of a coarser pitch, or with empty lags around it.

Patches smaller by a factor f give lags f times as far apart. Both estimates weight the same pixel pairs, by triangles of the
different widths, so the coarse estimate is a convolution of the fine one with the transform of the ratio of the two triangles.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from correlograph.lags import lag_grid
from invert.measure.spectrum import Measurement, read_measurement


def coarsen(measurement: Measurement, side: int) -> Measurement:
    """Return the measurement of the same object window on `side` coarser lags; lags beyond the estimate are set to its floor."""
    floor, kernel = measurement.noise.floor, _kernel(side, measurement.lag_grid.object_side)
    excess = measurement.values.astype(np.float64) - floor
    coarse = (kernel @ excess @ kernel.T + floor).astype(np.float32)
    return read_measurement(0.5 * (coarse + coarse[::-1, ::-1]))


@lru_cache(maxsize=8)
def _kernel(side: int, fine_side: int) -> np.ndarray:
    """Return the weights of the fine lags in each coarse lag, (2 side - 1, 2 fine_side - 1)."""
    factor = fine_side / side
    apart = (np.arange(4096) + 0.5) / 4096 / factor  # distance of two pixels in units of the fine patch
    ratio = (1.0 - factor * apart) / (1.0 - apart) * 2.0 / factor / apart.size
    distance = factor * lag_grid(side - 1).steps[:, None] - lag_grid(fine_side - 1).steps[None, :]
    values, where = np.unique(distance, return_inverse=True)
    return (np.cos(2.0 * np.pi * values[:, None] * apart) @ ratio)[where].reshape(distance.shape)


def pad(measurement: Measurement, side: int) -> Measurement:
    """Enlarge the object window to `side` lags of the same pitch; the added lags of the estimate are set to its floor."""
    margin = side - measurement.lag_grid.object_side
    values = np.pad(measurement.values, margin, constant_values=np.float32(measurement.noise.floor))
    return replace(measurement, values=values)
