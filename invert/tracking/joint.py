"""Exact paths of several objects together, by maximum likelihood.

The pattern of each object is a Gaussian random field of known power S that travels along its path p and fades as the illumination on the
object changes; noise and interference N are white. The spectra of frames t and s at a frequency f then have the covariance

    C_ts = sum over objects S(f) exp(-fading (t - s)^2) exp(-2 pi i f (p_t - p_s)), plus N(f) if t = s,

and the most probable paths follow by Fisher scoring (Slepian and Bangs: P. Stoica, R. Moses, Spectral Analysis of Signals, 2005, appendix
B; `normal_equations.py`). No pattern needs to be known, and none draws the path of another, whether they overlap or not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from invert.tracking.band import Band
from invert.tracking.central_lobe import central_lobe
from invert.tracking.components import MAX_LAG, Components, unmix
from invert.tracking.follow import Followed, approximate
from invert.tracking.interference import apart, find_interference, is_fitted
from invert.tracking.light import at_equal_light
from invert.tracking.likelihood import WHOLE, Likelihood
from invert.tracking.normal_equations import NormalEquations
from invert.tracking.register import MAX_REACH, drawn_by_windows, phase_walk, reach_of
from invert.tracking.shifts import weight_of
from invert.tracking.smoothing import PathNoise
from invert.tracking.start import Start, way_apart

FIRST_FREQUENCIES = 4000
"""Number of frequencies, drawn at random, of all rounds before the last one, and of the information."""

ROUNDS = 6
CONVERGED_GRAINS = 0.02
"""Largest change of a displacement between neighbours, in radii of a grain, at which the first rounds end."""

MAX_ERROR_GRAINS = 0.5
"""Largest standard error of a position between known neighbours, in radii of a grain: beyond it, the likelihood is no parabola. In less
light, every second position is estimated, every fourth, and so on, with straight lines between them."""

MAX_CORRECTION = 6.0
"""Radii of a grain by which an exact path may differ from the approximate one where it could change to another object."""

MIN_APART_GRAINS = 4.0
"""Radii of a grain by which objects must move apart within `MAX_LAG` frames. Between two equally bright objects of the radius g that are D
apart, interference draws the displacement by up to D exp(-D^2 / (8 g^2)), half a radius there."""

FOR_INTERFERENCE = 2**16
"""Number of values of the spectra by which interference is sought."""

DRAWN_ERROR = 2.0
"""Error of what the windows draw paths by, over its first order, which is corrected. Paths of several objects are drawn by up to four times
as much (docs/tracking_measured.md)."""


@dataclass(frozen=True)
class Fit:
    """Paths (n, frames, 2) of objects, with the equations and components that they were fitted by."""

    paths: np.ndarray
    equations: NormalEquations
    components: Components


def follow_several(spectra: np.ndarray, band: Band, starts: Sequence[Start]) -> list[Followed]:
    """Return the paths of several objects near approximate ones, from spectra (frames, R, C).

    Where the interference of objects is parted from the central lobe of their power, paths follow from this lobe. An object keeps its
    approximate path if the light does not suffice, if the path leaves its surroundings, and if interference would draw it; its light then
    counts as noise for the others. If frames are less likely with the exact paths, the differences are part of the errors, and all objects
    keep their approximate paths where they interfere.
    """
    spectra, central = at_equal_light(spectra, band), central_lobe(band)
    begun = np.stack([one.path for one in starts]).astype(np.float64)
    components = unmix(spectra, central, begun)
    found = [
        replace(approximate(one, central), power=power, in_common=share)
        for one, power, share in zip(starts, components.powers, components.in_common(band, len(spectra)), strict=True)
    ]
    may_interfere = central is band
    kept, fit = _fit_clear(spectra, central, begun, components, may_interfere)
    if fit:
        is_doubtful = _is_less_likely(spectra, central, fit.paths, begun[kept], is_fitted(band, central))
        shares = fit.components.in_common(band, len(spectra))
        for number, one, share in zip(kept, _describe(central, fit), shares, strict=True):
            if is_doubtful:
                path = begun[number] - begun[number, 0]
                one = replace(one, path=path if may_interfere else one.path, error=np.hypot(one.error, path - one.path))
            found[number] = replace(one, in_common=share)
    return found


def _fit_clear(
    spectra: np.ndarray, band: Band, begun: np.ndarray, components: Components, may_interfere: bool
) -> tuple[list[int], Fit | None]:
    """Fit the paths near approximate ones (n, frames, 2) of as many objects as allow it; return their numbers, too."""
    kept = list(range(len(begun)))
    while True:
        lost = _unclear(components) or (_interfering(band, begun[kept], components) if may_interfere else None)
        fit = lost or _fit(spectra, band, begun[kept], components)
        if isinstance(fit, Fit):
            return kept, fit
        kept = [number for index, number in enumerate(kept) if index not in fit]
        if not kept:
            return kept, None
        components = unmix(spectra, band, begun[kept])


def _is_less_likely(spectra: np.ndarray, band: Band, paths: np.ndarray, others: np.ndarray, fits_interference: bool) -> bool:
    """Return whether frames are less likely with paths than with others, (n, frames, 2) each; with the interference of their objects, if it
    is fitted."""
    both = [apart(list(paths)), apart(list(others))]
    if fits_interference:
        quick = Likelihood(spectra, band, FOR_INTERFERENCE)
        both = [find_interference(quick, each.paths) for each in both]
    whole = Likelihood(spectra, band, WHOLE)
    return whole.rise(both[0].tracks) < whole.rise(both[1].tracks)


def _fit(spectra: np.ndarray, band: Band, begun: np.ndarray, components: Components) -> Fit | frozenset[int]:
    """Fit paths near approximate ones (n, frames, 2), or name the objects without which the others may be fitted."""
    places = np.argwhere(band.counts > 0.0)
    few = places[np.random.default_rng(0).permutation(len(places))[:FIRST_FREQUENCIES]]
    equations = NormalEquations.of(spectra, band, components, few).add_information(begun)
    limit, tried = MAX_ERROR_GRAINS * band.grain_pixels / band.noise_gain**0.5, []
    for length in equations.lengths():
        equations = replace(equations, length=length)
        tried.append(equations.errors_between_neighbours())
        if tried[-1].max() < limit:
            break
    else:
        return frozenset([int(np.argmax(min(tried, key=np.max)))])
    paths = begun
    for _ in range(ROUNDS):
        paths, change = _advance(paths, equations, band.grain_pixels)
        if change < CONVERGED_GRAINS:
            break
    components = unmix(spectra, band, paths)
    if lost := _unclear(components):
        return lost
    last = NormalEquations.of(spectra, band, components, few).add_information(paths)
    equations = replace(
        NormalEquations.of(spectra, band, components, places), informations=last.informations, length=equations.length
    )
    paths, _ = _advance(paths, equations, band.grain_pixels)
    away = np.flatnonzero(np.abs(paths - begun).max((1, 2)) > MAX_CORRECTION * band.grain_pixels)
    return frozenset(away.tolist()) or Fit(paths, equations, components)


def _advance(paths: np.ndarray, equations: NormalEquations, grain_pixels: float) -> tuple[np.ndarray, float]:
    """Return paths moved up their likelihood, by at most the radius of a grain between neighbours, and the largest such change in radii."""
    step = equations.solve(paths)
    change = float(np.abs(np.diff(step, axis=1)).max()) / grain_pixels
    return paths + step * min(1.0, 1.0 / max(change, 1e-9)), change


def _unclear(components: Components) -> frozenset[int]:
    """Return objects of unknown fading, or without power."""
    return frozenset(np.flatnonzero(np.isnan(components.fading) | (components.powers.sum((1, 2)) <= 0.0)).tolist())


def _interfering(band: Band, paths: np.ndarray, components: Components) -> frozenset[int]:
    """Return objects that move apart so little within `MAX_LAG` frames that their interference, whose maximum lies halfway between theirs,
    draws their paths (n, frames, 2)."""
    lag = min(MAX_LAG, paths.shape[1] - 1)
    grains = [replace(band, signal=power).grain_pixels for power in components.powers]
    return frozenset(
        number
        for one, other in combinations(range(len(paths)), 2)
        if way_apart(paths[one], paths[other], lag) < MIN_APART_GRAINS * max(grains[one], grains[other])
        for number in (one, other)
    )


def _describe(band: Band, fit: Fit) -> list[Followed]:
    """Return the paths with their errors: those of the noise, and by the change of the illumination."""
    variances, bends = fit.equations.errors()
    found, components = [], fit.components
    for number, power in enumerate(components.powers):
        path = fit.paths[number] - fit.paths[number, 0]
        fading, its_band = float(components.fading[number]), replace(band, signal=power, floor=components.noise)
        drawn = _drawn_by_windows(path, its_band, fading)
        walked = phase_walk(path, fading, its_band)
        error = np.sqrt(band.noise_gain * variances[number] + walked + (DRAWN_ERROR * drawn) ** 2)
        path = path - drawn
        length = fit.equations.length
        noise = PathNoise(0.5 * band.noise_gain * bends[number])  # white
        found.append(Followed(path, error, length, power, noise=noise, fading=fading))
    return found


def _drawn_by_windows(path: np.ndarray, band: Band, fading: float) -> np.ndarray:
    """Return by how much the windows draw the path (frames, 2) of one of several objects, (frames, 2), to first order."""
    likeness = np.exp(-fading * np.arange(1.0, min(MAX_REACH, len(path) - 1) + 1.0) ** 2)
    reach = reach_of(likeness)
    weight = weight_of(band, float(likeness[0]), min(2 * reach, len(path) - 1))
    turns = [2.0 * np.pi * one for one in (band.rows[:, None], band.columns)]
    curvature = np.array([[(weight.values * band.signal * one * other).sum() for other in turns] for one in turns])
    inverse = np.linalg.inv(float(likeness[:reach].mean()) * curvature)
    return drawn_by_windows(path, band, weight, likeness[:reach], np.ones(len(path)), inverse)
