"""Noise statistics of estimates, and the published lab series they are read from."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import curve_fit

from correlograph.errors import InputError
from correlograph.files.images import read_autocorrelation
from correlograph.lags import lag_grid_of
from radiometry.noise.measured_noise import extrapolated_peak, fill_zero_lag, fit_known_signal, read_noise_level

CORNER = 20
"""Side of the signal-free corner whose mean and variance Metzler et al. 2020 plot."""

BROKEN_EXPOSURE_S = 1.5
"""The lab's longest exposure, whose floor rises again: left out of the fit."""


def corner(estimate: np.ndarray, dof: int, **facts: float) -> dict[str, float]:
    """Return mean and variance of the signal-free corner, which excludes the row and column through zero lag."""
    values = estimate[:CORNER, :CORNER].astype(np.float64)
    return {**facts, "dof": dof, "mean": float(values.mean()), "variance": float(values.var(ddof=1))}


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Return the slope through the origin as the geometric mean of y / x: all points have equal weight, because their errors
    are relative.
    """
    ratio = np.asarray(y) / np.asarray(x)
    return float(np.exp(np.log(ratio).mean()))


def _lab_pictures(folder: Path, pattern: str) -> list[tuple[float, np.ndarray]]:
    """(number in the name, lags) of every picture that fits `pattern`, in order."""
    found = []
    for path in sorted(folder.glob("*.png")):
        match = re.fullmatch(pattern, path.name)
        if match:
            found.append((float(match.group(1)), read_autocorrelation(path)[0]))
    if not found:
        raise InputError(
            "--measured",
            "published autocorrelations of the 2020 paper",
            f"none named like {pattern} in {folder}",
            "check the folder",
        )
    return sorted(found, key=lambda pair: pair[0])


def _lab_series(folder: Path) -> list[tuple[float, np.ndarray]]:
    return [(usec * 1e-6, lags) for usec, lags in _lab_pictures(folder, r"lowExp_7_2_(\d+)usec_.*\.png")]


def lab_over_exposure(folder: Path) -> list[dict[str, float]]:
    return [corner(lags, 64, exposure_s=exposure_s) for exposure_s, lags in _lab_series(folder)]


def lab_over_patches(folder: Path) -> list[dict[str, float]]:
    return [
        corner(lags, int(patches), patches=patches)
        for patches, lags in _lab_pictures(folder, r"._n2_corr_x100_nzero1_npatch(\d+)\.png")
    ]


def lab_floor(folder: Path) -> dict[str, Any]:
    """Fit b / peak = a / t + c to the lab's exposure series, by least relative error.

    The object's r*r is the mean of the estimates at exposures from 0.5 s on, without their floor. Its fit to each
    estimate also gives a scale to short exposures, whose peaks are lost in noise.
    """
    series = _lab_series(folder)
    long = [fill_zero_lag(lags - read_noise_level(lags, 1.0).floor, 0.0) for t, lags in series if 0.5 <= t < BROKEN_EXPOSURE_S]
    template = np.clip(np.mean([lags / lags.max() for lags in long], axis=0), 0.0, None)
    template[read_noise_level(template).signal_ring < lag_grid_of(template).ring] = 0.0
    peak, _ = extrapolated_peak(template, read_noise_level(template))
    points = []
    for exposure_s, lags in series:
        gain, floor = fit_known_signal(lags, template, lines=True)
        points.append({"exposure_s": exposure_s, "floor_over_peak": floor / (gain * peak)})
    used = [p for p in points if p["exposure_s"] < 0.99 * BROKEN_EXPOSURE_S]
    t, b = (np.array([p[name] for p in used]) for name in ("exposure_s", "floor_over_peak"))
    (a, c), covariance = curve_fit(lambda seconds, a, c: a / seconds + c, t, b, sigma=b)
    error = np.sqrt(np.diag(covariance))
    return {"a_s": float(a), "a_error_s": float(error[0]), "c": float(c), "c_error": float(error[1]), "points": points}
