"""Several objects, by the likelihood of their paths together.

An object is added where the frames are most likely with it: at a candidate, or beside an object that is known, along a path that differs
from its own by a constant velocity. All paths are then moved by constant velocities, together with their interference, to the maximum of
their likelihood: what was one path between two objects becomes that of one of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, product

import numpy as np

from invert.tracking.band import Band
from invert.tracking.central_lobe import central_lobe
from invert.tracking.explained import Explained
from invert.tracking.interference import Together, apart, begin_interference, find_interference, is_fitted, maximise
from invert.tracking.likelihood import WHOLE, Likelihood
from invert.tracking.start import are_distinct

MIN_RELATIVE_POWER = 0.12
"""Least power of the speckle of an object over that of the brightest."""

MODES, MIN_GAIN = 3, 0.05
"""Largest number of modes of patterns that change, and least part by which a further object must raise what is explained: two patterns
explain the change of a single one, too. It may therefore have one mode more. Steady patterns must explain more than those that change."""

QUICK, QUICK_FREQUENCIES = 1e4, 1300
"""Paths are sought at as few frequencies as raise the logarithm of the likelihood by this along the path of a single object, and at no
fewer than a number of them, or half of it, because they are evenly spaced."""

PITCH, REACH = 1.5, 4
"""Pitch of the velocities at which an object is sought beside another, in half grains over the largest distance of frames, and their
greatest difference in pitches."""

STARTS = 2
"""Numbers of paths from the candidates, and from beside other objects, that are moved to their maxima; and how many of these, one fewer for
each further object, are moved together with their interference."""


class Several:
    """Objects in spectra (frames, R, C), with paths (frames, 2), by the frequencies of a band."""

    def __init__(self, spectra: np.ndarray, band: Band, lags: Sequence[int], alone: np.ndarray) -> None:
        """Take distances of frames, the largest first, and the path of a single object, (frames, 2)."""
        whole_band, band = band, central_lobe(band)
        self._fits_interference = is_fitted(whole_band, band)
        self._shared = Explained(spectra, band, lags)
        self._whole = Likelihood(spectra, band, WHOLE)
        whole = self._whole.frequencies
        wanted = max(QUICK_FREQUENCIES, whole * QUICK / max(self.rise([alone]), 1.0))
        self._quick = Likelihood(spectra, band, len(spectra) * int(wanted)) if wanted < whole else self._whole
        self.band, self._lag, self._step = band, lags[0], 0.5 * band.grain_pixels / lags[0]
        self._numbers = np.arange(len(spectra))[:, None]

    @property
    def cells(self) -> int:
        """Twice what a path explains of noise."""
        return self._whole.cells

    def rise(self, tracks: Sequence[np.ndarray]) -> float:
        """Return by how much steady patterns along paths (frames, 2) or tracks (frames, 3) raise the logarithm of the likelihood of all
        frames."""
        return self._whole.rise(tracks)

    def powers(self, paths: Sequence[np.ndarray]) -> np.ndarray:
        """Return the power of the speckle along each path as a share of that of all speckle in the band, (n,)."""
        return self._shared.fit(paths)[0]

    def settle(self, paths: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return paths moved by constant velocities to the maximum of their likelihood, as if they did not interfere."""
        return self._maximise(apart(paths)).paths

    def add_object(self, known: Sequence[np.ndarray], candidates: Sequence[np.ndarray]) -> list[np.ndarray] | None:
        """Return the paths of known objects and of a further one, the most likely; None if there is none."""
        settled = sorted((self.settle(one) for one in self._begun(known, candidates)), key=self.rise, reverse=True)
        objects = [paths for paths in settled if self._are_objects(known, paths)]
        if not objects:
            return None
        before, found = apart(known), [apart(paths) for paths in objects]
        if self._fits_interference:
            before = find_interference(self._quick, known)
            found = self._interfering(known, objects[: max(1, STARTS + 1 - len(known))])
        limits = self._limits(before)
        return next((one.paths for one in found if self._are_likely(one, *limits)), None)

    def _interfering(self, known: Sequence[np.ndarray], likely: Sequence[list[np.ndarray]]) -> list[Together]:
        """Return known objects and a further one with their interference, near paths that are likely without it, the likeliest first."""
        found = [self._maximise(begin_interference(self._quick, paths)) for paths in likely]
        found.sort(key=lambda one: self.rise(one.tracks), reverse=True)
        return [one for one in found if self._are_objects(known, one.paths)]

    def _maximise(self, begun: Together) -> Together:
        """Return objects at the maximum of their likelihood, if all frequencies say that they are likelier than begun ones."""
        best = maximise(self._quick, begun, self._step)
        return best if self.rise(best.tracks) > self.rise(begun.tracks) else begun

    def _limits(self, known: Together) -> tuple[float, float]:
        """Return what steady patterns of more objects must explain to be taken, and what patterns that change must."""
        changing = [self._whole.rise(known.paths, modes) for modes in range(1, MODES + 2)]
        with_interference = [self._whole.rise(known.tracks, modes) for modes in (1, 2)] if len(known.between) else []
        return max(changing[:MODES]) + self.cells, (1.0 + MIN_GAIN) * max(changing + with_interference) + self.cells

    def _are_likely(self, together: Together, steady: float, changing: float) -> bool:
        """Return whether objects explain more than patterns of known ones that change; see `_limits`."""
        found = [self._whole.rise(together.paths, modes) for modes in range(1, MODES + 1)]
        return found[0] > steady or max(*found, self.rise(together.tracks)) > changing

    def _begun(self, known: Sequence[np.ndarray], candidates: Sequence[np.ndarray]) -> Iterator[list[np.ndarray]]:
        """Yield paths of known objects and of a further one, near the maximum of their likelihood."""
        patterns = [self._quick.pattern(one) for one in known]
        places = [PITCH * np.array(one) for one in product(range(-REACH, REACH + 1), repeat=2) if 0 < np.hypot(*one) <= REACH]
        beside = [path + self._step * self._numbers * place for path in known for place in places]
        for paths in (candidates, beside):
            likely = [self._quick.of([*patterns, self._quick.pattern(one)]) for one in paths]
            for index in np.argsort(likely)[: -STARTS - 1 : -1]:
                yield [*known, paths[index]]

    def _are_objects(self, known: Sequence[np.ndarray], paths: Sequence[np.ndarray]) -> bool:
        """Return whether paths are apart, and those of bright objects that explain more than known ones of what distant frames share."""
        (_, before), (powers, after) = self._shared.fit(known), self._shared.fit(paths)
        explains = after > before + self._shared.cells  # twice what noise would
        distinct = (are_distinct(*pair, self._lag, self.band) for pair in combinations(paths, 2))
        return bool(explains and powers.min() > MIN_RELATIVE_POWER * powers.max() and all(distinct))
