"""Candidates for the objects of a capture, compared by what their paths explain together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from invert.tracking.band import Band
from invert.tracking.explained import Explained
from invert.tracking.start import Start, are_apart

MIN_RELATIVE_POWER = 0.12
"""Least power of the speckle of an object over that of the brightest."""

SWEEPS = 2
"""Number of times that each known object may be exchanged."""


class Candidates:
    """Candidates that frames at some distances showed, each known by its number."""

    def __init__(self, spectra: np.ndarray, band: Band, lags: Sequence[int]) -> None:
        """Take spectra (frames, R, C), and the distances of frames at which paths are compared."""
        self._explained, self._band = Explained(spectra, band, lags), band
        self._starts: list[Start] = []

    def __len__(self) -> int:
        return len(self._starts)

    def add(self, starts: Iterable[Start]) -> None:
        """Take further candidates."""
        for one in starts:
            self._explained.add(one.path)
            self._starts.append(one)

    def best_beside(self, known: Sequence[int]) -> int | None:
        """Return the candidate that explains most beside known objects; None if it is faint, or explains no more than twice what it would
        of noise."""
        gains = {one: self._explained.by([*known, one]) for one in range(len(self)) if self._is_new(one, known)}
        if not gains:
            return None
        best = max(gains, key=lambda one: gains[one])
        powers = self._explained.powers([*known, best])
        explains = gains[best] - self._explained.by(known) > self._explained.cells
        return best if explains and powers[-1] > MIN_RELATIVE_POWER * powers.max() else None

    def exchange(self, known: Sequence[int]) -> list[int]:
        """Return known objects, each exchanged for the candidate that explains most beside the others."""
        chosen = list(known)
        for _ in range(SWEEPS):
            for place, old in enumerate(chosen):
                others = chosen[:place] + chosen[place + 1 :]
                possible = [old, *(one for one in range(len(self)) if self._is_new(one, others))]
                chosen[place] = max(possible, key=lambda one: self._explained.by([*others, one]))
        return chosen

    def explained_by(self, number: int) -> float:
        """Return what the path of a candidate explains alone; see `Explained.by`."""
        return self._explained.by([number])

    def objects(self, known: Sequence[int]) -> list[Start]:
        """Return known objects, the brightest first, with the shares of the power that their paths explain together."""
        powers = self._explained.powers(known)
        return [replace(self._starts[known[place]], share=float(powers[place])) for place in np.argsort(-powers)]

    def _is_new(self, number: int, known: Sequence[int]) -> bool:
        """Return whether a candidate is apart from known objects at the distance of frames by which it was found."""
        one, others = self._starts[number], (self._starts[other] for other in known)
        return number not in known and all(are_apart(one.path, other.path, one.lag, self._band) for other in others)
