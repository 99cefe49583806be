"""Noise level read from an autocorrelation estimate: floor b and degrees of freedom K from the lags without signal, and
the height of the signal above the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from correlograph.lags import LagGrid, lag_grid_of

WHOLE_FRAME_INFLATION = 2.25
"""Variance inflation of an estimate from all pixel pairs: the sum of `radiometry.noise.model.lag_correlation` is 1.5 along each axis."""

ASSUMED_DOF = 64.0
"""K of an estimate whose noise is hidden by rounding: the value of two frames in Metzler et al. 2020."""

NEGLIGIBLE = 1e-6
"""Floors below this fraction of the maximum lag are leakage and rounding, whose scatter does not depend on K."""

SIGNAL_FREE_PART = 8
"""No signal is assumed in the outermost rings, an eighth of the lags."""


def outermost_signal_ring(grid: LagGrid) -> int:
    """Return the largest ring of lags in which an object may have signal."""
    return grid.lags - grid.object_side // SIGNAL_FREE_PART


_APART = 6
"""Distance in lags at which noise is practically uncorrelated."""


@dataclass(frozen=True)
class NoiseLevel:
    """Floor b (in the unit of the estimate), degrees of freedom K, and the radius in lags beyond which there is no signal.

    `dof` is None if the outer lags do not vary or are practically zero (no noise at all).

    Attributes:
        inflation: variance inflation, the variance of a sum over many neighbouring lags in units of that of independent lags: 1
            for non-overlapping patches, 2.25 for whole frames, whose lags are correlated.
        dof_read: False if rounding hides the noise and `dof` is assumed to be `ASSUMED_DOF`.
    """

    floor: float
    dof: float | None
    signal_ring: int
    inflation: float = 1.0
    dof_read: bool = True

    @property
    def deviation(self) -> float:
        """Standard deviation of a lag without signal."""
        return self.floor / self.dof**0.5 if self.dof else 0.0


def _variance(mean: float, dof: float | None, quantisation: float) -> float:
    """Return the variance of a lag without signal: Gamma noise and rounding."""
    return (mean**2 / dof if dof else 0.0) + quantisation**2 / 12.0


def _moments(values: np.ndarray, quantisation: float) -> tuple[float, float | None]:
    """Return the mean and K = mean^2 / variance, with the variance of rounding to `quantisation` removed."""
    mean = float(values.mean(dtype=np.float64))
    variance = float(values.var(dtype=np.float64, ddof=1)) - quantisation**2 / 12.0
    return mean, (mean**2 / variance if variance > 1e-12 * mean**2 else None)


def _inflation(estimate: np.ndarray, outside: np.ndarray) -> float:
    """Return the variance inflation of sums of lags, from the correlation of neighbours outside the signal.

    This correlation follows from the differences of neighbours and of lags `_APART` apart, whatever the slope of the floor. It is
    summed over all distances n, assuming that it falls as 1 / n^2 (`radiometry.noise.model.lag_correlation`).
    """
    inflation = 1.0
    for view, used in ((estimate, outside), (estimate.T, outside.T)):
        view = view.astype(np.float64)
        differences = []
        for apart in (1, _APART):
            both = used[:, apart:] & used[:, :-apart]
            differences.append(((view[:, apart:] - view[:, :-apart])[both] ** 2).sum() / max(both.sum(), 1))
        correlation = 1.0 - differences[0] / differences[1] if differences[1] > 0.0 else 0.0
        if correlation > 3.0 / outside.sum() ** 0.5:
            inflation *= 1.0 + np.pi**2 / 3.0 * min(correlation, 0.5)
    return float(inflation)


def read_noise_level(estimate: np.ndarray, quantisation: float = 0.0) -> NoiseLevel:
    """Read floor and K from the outer lags of an estimate.

    The search starts at the outermost rings and moves inwards while the mean of a ring agrees with the rings outside it. The row and
    column through zero lag are excluded. Rings in the inner half never count as free of signal; the lags outside suffice.

    Args:
        estimate: (n, n), n odd, zero lag in the middle.
        quantisation: step of an estimate stored as integers (1 for 8-bit images), 0 for floating-point values.
    """
    grid = lag_grid_of(estimate)
    off_axis, rings = grid.off_axis, grid.ring
    outermost = outermost_signal_ring(grid)
    mean, dof = _moments(estimate[off_axis & (rings > outermost)], quantisation)
    inflation = _inflation(estimate, off_axis & (rings > outermost))
    boundary, misses = outermost, 0
    for ring in range(outermost, grid.lags // 2, -1):
        values = estimate[off_axis & (ring == rings)]
        error = (inflation**0.5 * _variance(mean, dof, quantisation) / values.size) ** 0.5  # neighbours along a line
        if abs(float(values.mean()) - mean) > 3.0 * error + 1e-9 * abs(mean):
            misses += 1
            if misses == 2:
                break
        else:
            boundary, misses = ring - 1, 0
            mean, dof = _moments(estimate[off_axis & (boundary < rings)], quantisation)
    # A boxcar patch leaks signal along both axes of the lags, but hardly into their corners.
    corners = off_axis & (
        np.minimum(np.abs(grid.row), np.abs(grid.column)) > min(boundary, outermost - 3 * grid.object_side // 16)
    )
    corner_mean, corner_dof = _moments(estimate[corners], quantisation)
    sides = off_axis & (boundary < rings) & ~corners
    variance = _variance(corner_mean, corner_dof, quantisation)
    error = (inflation * variance * (1.0 / corners.sum() + 1.0 / max(sides.sum(), 1))) ** 0.5
    if sides.any() and abs(float(estimate[sides].mean()) - corner_mean) > 3.0 * error + 1e-9 * abs(corner_mean):
        mean, dof = corner_mean, corner_dof
    if mean < NEGLIGIBLE * float(np.delete(estimate, estimate.size // 2).max()):
        dof = None
    if dof is None and quantisation > 0.0:
        return NoiseLevel(mean, ASSUMED_DOF, boundary, dof_read=False)
    outside = off_axis & (min(boundary, outermost) < rings)
    return NoiseLevel(mean, dof, boundary, _inflation(estimate, outside) if dof else 1.0)


def extrapolated_peak(estimate: np.ndarray, noise: NoiseLevel, radius: int = 4) -> tuple[float, float]:
    """Return the height of r*r at zero lag above the floor, and its standard error, from the lags around it.

    A weighted least-squares surface of constant, cone and paraboloid is fitted to lags 1..`radius`. The cone describes the cusp of
    r*r of an object with edges. Zero lag itself is never used: it contains the drift of the laser power, and published estimates set
    it to zero.
    """
    grid = lag_grid_of(estimate)
    distance = np.hypot(grid.row, grid.column)
    near = grid.half_plane & (distance <= radius)
    row, column, cone = grid.row[near].astype(float), grid.column[near].astype(float), distance[near]
    basis = np.stack(
        [np.ones_like(row), cone, (row**2 - column**2) / cone, row * column / cone, row**2, column**2, row * column], axis=1
    )
    values = estimate[near].astype(np.float64)
    if values.max() <= 0.0:
        return 0.0, 0.0
    weight = 1.0 / np.maximum(values, max(noise.floor, 1e-3 * values.max()))
    weighted = basis * weight[:, None]
    solution = np.linalg.lstsq(weighted, (values - noise.floor) * weight, rcond=None)[0]
    # Gamma noise: every weighted lag has the variance 1 / K.
    error = float(np.linalg.inv(weighted.T @ weighted)[0, 0] * noise.inflation / noise.dof) ** 0.5 if noise.dof else 0.0
    return max(float(solution[0]), 0.0), error


def fit_known_signal(
    estimate: np.ndarray, signal: np.ndarray, *, lines: bool = False, iterations: int = 20
) -> tuple[float, float]:
    """Fit estimate = gain x signal + floor over all lags except zero; return (gain, floor).

    Iteratively reweighted least squares with weights 1/S^2, where S is the fitted value, is the
    maximum-likelihood fit of Gamma noise with constant K.

    Args:
        estimate: (n, n).
        signal: (n, n), H (r*r) smoothed by the patch window.
        lines: whether the row and column through zero lag contain read noise and are excluded.
    """
    grid = lag_grid_of(estimate)
    use = grid.off_axis if lines else grid.half_plane
    basis = np.stack([signal[use].astype(np.float64), np.ones(int(use.sum()))], axis=1)
    values = estimate[use].astype(np.float64)
    model = np.full_like(values, values.mean())
    gain, floor = 0.0, float(values.mean())
    for _ in range(iterations):
        weight = 1.0 / model
        gain, floor = np.linalg.lstsq(basis * weight[:, None], values * weight, rcond=None)[0]
        model = np.maximum(basis @ np.array([gain, floor]), 1e-6 * values.mean())
    return float(gain), float(floor)


def fill_zero_lag(estimate: np.ndarray, value: float) -> np.ndarray:
    """Return a copy of an estimate with zero lag replaced by `value`."""
    filled = np.array(estimate, dtype=np.float32)
    middle = lag_grid_of(estimate).lags
    filled[middle, middle] = value
    return filled


def dim_zero_lag(estimate: np.ndarray) -> np.ndarray:
    """Return a copy of an estimate for display: zero lag is limited to the maximum of the other lags."""
    return fill_zero_lag(estimate, np.partition(estimate.ravel(), -2)[-2])
