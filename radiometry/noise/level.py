"""Noise level of an autocorrelation estimate, read back from it: floor b, degrees of freedom K, signal height.

Reads the floor b and K from lags without signal, and the height of the signal over the floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from correlograph.lags import LAGS

_STEP = np.arange(-LAGS, LAGS + 1)
ROW_LAG, COLUMN_LAG = np.meshgrid(_STEP, _STEP, indexing="ij")
RING = np.maximum(np.abs(ROW_LAG), np.abs(COLUMN_LAG))
"""Square ring of every lag: the autocorrelation of an object in a box lies inside one ring."""

HALF_PLANE = (ROW_LAG > 0) | ((ROW_LAG == 0) & (COLUMN_LAG > 0))
"""One of every pair of equal lags (+lag and -lag), zero lag left out."""

ASSUMED_DOF = 64.0
"""K of an estimate rounded so coarsely that its noise cannot be read: that of the paper's two frames."""

NEGLIGIBLE = 1e-6
"""Floors below this share of the largest lag are leakage and rounding, whose scatter says nothing of K."""

OUTERMOST = LAGS - 8
"""Rings beyond this are the first guess of where no signal is."""

_APART = 6
"""Lags so far apart are as good as independent."""

INNERMOST = LAGS // 2
"""Rings inside this are never taken for signal-free: half the picture holds lags enough."""


@dataclass(frozen=True)
class NoiseLevel:
    """Floor b (in the estimate's units), degrees of freedom K, and the ring where the signal ends.

    `dof` is None where the outer lags do not vary or hold next to nothing (no noise at all).

    Attributes:
        inflation: variance of a sum over many neighbouring lags over that of as many independent ones: 1 for patches side by
            side, 2.25 for whole frames, whose lags correlate.
        dof_read: False where rounding hides the noise, and `dof` is assumed to be `ASSUMED_DOF`.
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


OFF_AXIS = HALF_PLANE & (ROW_LAG != 0) & (COLUMN_LAG != 0)
"""Independent lags off the row and column through zero, where read noise of lines collects."""


def _variance(mean: float, dof: float | None, quantisation: float) -> float:
    """Variance of a lag without signal: Gamma noise and rounding."""
    return (mean**2 / dof if dof else 0.0) + quantisation**2 / 12.0


def _moments(values: np.ndarray, quantisation: float) -> tuple[float, float | None]:
    """Mean and K = mean^2 / variance; the variance of rounding to `quantisation` is taken out."""
    mean = float(values.mean(dtype=np.float64))
    variance = float(values.var(dtype=np.float64, ddof=1)) - quantisation**2 / 12.0
    return mean, (mean**2 / variance if variance > 1e-12 * mean**2 else None)


def _inflation(estimate: np.ndarray, outside: np.ndarray) -> float:
    """Variance inflation of sums of lags, from the correlation of neighbours outside the signal.

    Differences of neighbours against those of lags `_APART` apart tell it, whatever the floor's slope; correlations that fall
    as 1 / n^2 (`radiometry.noise.model.lag_correlation`) are summed up.
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

    Starts from the outermost rings and moves inwards while a ring's mean agrees with those outside
    it; the row and column through zero lag are left out.

    Args:
        estimate: (127, 127), zero lag in the middle.
        quantisation: step of an estimate stored as integers (1 for 8-bit pictures), 0 for none.
    """
    mean, dof = _moments(estimate[OFF_AXIS & (RING > OUTERMOST)], quantisation)
    inflation = _inflation(estimate, OFF_AXIS & (RING > OUTERMOST))
    boundary, misses = OUTERMOST, 0
    for ring in range(OUTERMOST, INNERMOST, -1):
        values = estimate[OFF_AXIS & (ring == RING)]
        error = (inflation**0.5 * _variance(mean, dof, quantisation) / values.size) ** 0.5  # neighbours along a line
        if abs(float(values.mean()) - mean) > 3.0 * error + 1e-9 * abs(mean):
            misses += 1
            if misses == 2:
                break
        else:
            boundary, misses = ring - 1, 0
            mean, dof = _moments(estimate[OFF_AXIS & (boundary < RING)], quantisation)
    # A boxcar patch leaks signal along both axes of the lags, but hardly into their corners.
    corners = OFF_AXIS & (np.minimum(np.abs(ROW_LAG), np.abs(COLUMN_LAG)) > min(boundary, OUTERMOST - 12))
    corner_mean, corner_dof = _moments(estimate[corners], quantisation)
    sides = OFF_AXIS & (boundary < RING) & ~corners
    variance = _variance(corner_mean, corner_dof, quantisation)
    error = (inflation * variance * (1.0 / corners.sum() + 1.0 / max(sides.sum(), 1))) ** 0.5
    if sides.any() and abs(float(estimate[sides].mean()) - corner_mean) > 3.0 * error + 1e-9 * abs(corner_mean):
        mean, dof = corner_mean, corner_dof
    if mean < NEGLIGIBLE * float(np.delete(estimate, estimate.size // 2).max()):
        dof = None
    if dof is None and quantisation > 0.0:
        return NoiseLevel(mean, ASSUMED_DOF, boundary, dof_read=False)
    outside = OFF_AXIS & (min(boundary, OUTERMOST) < RING)
    return NoiseLevel(mean, dof, boundary, _inflation(estimate, outside) if dof else 1.0)


def extrapolated_peak(estimate: np.ndarray, noise: NoiseLevel, radius: int = 4) -> tuple[float, float]:
    """Height of r*r at zero lag above the floor, and its standard error, from the lags around it.

    A weighted least-squares surface of constant, cone and paraboloid through lags 1..`radius`; the
    cone is there because r*r of an object with edges has a cusp. Zero lag itself is never used: it
    holds laser power drift, and published estimates set it to zero.
    """
    distance = np.hypot(ROW_LAG, COLUMN_LAG)
    near = HALF_PLANE & (distance <= radius)
    row, column, cone = ROW_LAG[near].astype(float), COLUMN_LAG[near].astype(float), distance[near]
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
    """Fit estimate = gain x signal + floor over all lags but zero; returns (gain, floor).

    Iteratively reweighted least squares with weights 1/S^2, which is the maximum-likelihood fit of
    Gamma noise with constant K.

    Args:
        estimate: (127, 127).
        signal: (127, 127), H (r*r) as the patch window smooths it.
        lines: whether read noise stands on the row or column through zero lag, which are then left out.
    """
    use = OFF_AXIS if lines else HALF_PLANE
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
    """Copy of an estimate with zero lag replaced by `value`."""
    filled = np.array(estimate, dtype=np.float32)
    filled[LAGS, LAGS] = value
    return filled


def dim_zero_lag(estimate: np.ndarray) -> np.ndarray:
    """Copy of an estimate to look at: zero lag, which would outshine the rest, no brighter than the brightest other lag."""
    return fill_zero_lag(estimate, np.partition(estimate.ravel(), -2)[-2])
