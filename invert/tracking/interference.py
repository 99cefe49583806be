"""Interference of objects, and what frames show of objects together with it.

The fields of two objects add, and frames show their product, too. If the albedos are Gaussian with the variances s1 and s2 and centres c1
and c2, in units of spatial frequency, the product moves by d = (s1 d1 + s2 d2) / (s1 + s2) where the fields move by d1 and d2: along a path
between theirs, nearer to that of the larger object. Its phase turns by c2 (d2 - d) - c1 (d1 - d), and by whatever light paths change. It
fades as exp(-2 pi^2 |d1 - d2|^2 s1 s2 / (s1 + s2)). Because frames are real, each product appears with its conjugate, whose phase turns the
other way: the patterns are a exp(-2 pi i (f p + phase)). Where a frequency shows only one of them, the other, with a similar turn,
describes how it fades.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import minimize

from invert.tracking.band import Band
from invert.tracking.likelihood import Likelihood

MIN_GRAINS = 300.0
"""Least number of grains in a frame from which interference is fitted: with fewer, its fits follow noise (docs/tracking_measured.md)."""

HALF, TURNS = 0.5, np.arange(0.0, 0.5, 0.02)
"""Share of interference at which the search begins, and the turns of its phase among which the most likely is sought, in cycles per
frame."""

PRECISION, RISE, TRIALS = 5e-4, 1e-4, 50
"""Relative change of the numbers of a search for a maximum, of which each step takes a hundred times as much, and of what is raised, at
which it ends; and the values of the likelihood per number at most."""

BETWEEN_STEPS = np.array([0.1, 0.02])
"""Units of shares and turns in a search for a maximum."""


@dataclass(frozen=True)
class Together:
    """Objects with paths (frames, 2), and the interference of each two of them.

    Attributes:
        between: shares and turns, (pairs, 2), see `interference_tracks`; (0, 2) for objects that do not interfere.
    """

    paths: list[np.ndarray]
    between: np.ndarray

    @property
    def tracks(self) -> list[np.ndarray]:
        """Tracks of all patterns of the frames."""
        if not len(self.between):
            return self.paths
        pairs = zip(combinations(self.paths, 2), self.between, strict=True)
        return [*self.paths, *(track for pair, numbers in pairs for track in interference_tracks(*pair, *numbers))]


def is_fitted(band: Band, central: Band) -> bool:
    """Return whether interference is fitted: no valley parts it from the central lobe of a band, and a frame has enough grains."""
    return central is band and band.cells > MIN_GRAINS


def apart(paths: Sequence[np.ndarray]) -> Together:
    """Return objects with paths (frames, 2), as if they did not interfere."""
    return Together(list(paths), np.empty((0, 2)))


def interference_tracks(one: np.ndarray, other: np.ndarray, share: float, turn: float) -> list[np.ndarray]:
    """Return the tracks (frames, 3) of the interference of objects with paths (frames, 2): places in pixels, and phases in cycles.

    Args:
        share: part of the way from the first path to the other at which it moves.
        turn: cycles by which its phase turns per frame.
    """
    between, phases = (1.0 - share) * one + share * other, turn * np.arange(len(one))
    return [np.column_stack([between, phases]), np.column_stack([between, -phases])]


def begin_interference(likelihood: Likelihood, paths: Sequence[np.ndarray]) -> Together:
    """Return objects with the interference of each two that is the most likely without that of others."""
    known = [likelihood.pattern(one) for one in paths]

    def of_pair(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        def likely(numbers: np.ndarray) -> float:
            return likelihood.of([*known, *(likelihood.pattern(each) for each in interference_tracks(one, other, *numbers))])

        halfway = max((np.array([HALF, turn]) for turn in TURNS), key=likely)
        least = likely(halfway)
        return _limited(
            halfway + BETWEEN_STEPS * _highest(lambda tried: likely(_limited(halfway + BETWEEN_STEPS * tried)) - least, 2)
        )

    return Together(list(paths), np.array([of_pair(*pair) for pair in combinations(paths, 2)]).reshape(-1, 2))


def find_interference(likelihood: Likelihood, paths: Sequence[np.ndarray]) -> Together:
    """Return objects with the most likely interference."""
    return maximise(likelihood, begin_interference(likelihood, paths), 0.0)


def maximise(likelihood: Likelihood, begun: Together, step: float) -> Together:
    """Return objects at a maximum of their likelihood near begun ones.

    The interference is free, and so are constant velocities that are added to all paths, in steps of some pixels per frame; paths stay if
    the step is 0. Blocks have the length that makes the frames most likely at the beginning of a search; another search follows if it is
    another at its end.
    """
    moving, frames = len(begun.paths) if step else 0, np.arange(len(begun.paths[0]))[:, None]

    def at(tried: np.ndarray) -> Together:
        velocities, between = np.split(tried.reshape(-1, 2), [moving])
        paths = (
            [path + step * frames * one for path, one in zip(begun.paths, velocities, strict=True)] if moving else begun.paths
        )
        return Together(paths, _limited(begun.between + BETWEEN_STEPS * between))

    at_length = likelihood.at_likely_length(begun.tracks)
    found = at(_highest(lambda tried: at_length.rise(at(tried).tracks), 2 * (moving + len(begun.between))))
    is_last = likelihood.at_likely_length(found.tracks).block_count == at_length.block_count
    return (
        found
        if is_last or likelihood.rise(found.tracks) <= likelihood.rise(begun.tracks)
        else maximise(likelihood, found, step)
    )


def _limited(between: np.ndarray) -> np.ndarray:
    """Return shares and turns (..., 2) with shares folded into those from 0 to 1, so that no change of them is without effect."""
    shares, turns = np.moveaxis(between, -1, 0)
    return np.stack([np.abs((shares + 1.0) % 2.0 - 1.0), turns], -1)


def _highest(rise: Callable[[np.ndarray], float], size: int) -> np.ndarray:
    """Return the numbers near zero at which a function of so many is highest."""
    if not size:
        return np.zeros(0)
    options = {"xtol": PRECISION, "ftol": RISE, "maxfev": TRIALS * size}
    return minimize(lambda tried: -rise(tried), np.zeros(size), method="Powell", options=options).x
