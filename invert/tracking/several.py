"""Several objects, by the likelihood of their paths together.

An object is added where the frames are most likely with it: at a candidate, or beside an object that is known, along a path that differs
from its own by a constant velocity. All paths are then moved by constant velocities, together with their interference, to the maximum of
their likelihood: what was one path between two objects becomes that of one of them. Where patterns change more than objects interfere,
this likelihood is that of patterns that fade (`fading.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import combinations, product

import numpy as np

from invert.tracking.band import Band
from invert.tracking.central_lobe import central_lobe
from invert.tracking.climb import climb
from invert.tracking.explained import Explained
from invert.tracking.fading import FINE, SOUGHT, FadingLikelihood
from invert.tracking.interference import Together, apart, begin_interference, find_interference, is_fitted, maximise
from invert.tracking.likelihood import WHOLE, Likelihood
from invert.tracking.maxima import MIN_RELATIVE_HEIGHT
from invert.tracking.start import are_distinct, way_apart
from invert.tracking.strange import are_strange

MIN_RELATIVE_POWER = 0.12
"""Least power of the speckle of an object over that of the brightest, where interference is not fitted."""

MODES, MIN_GAIN = 3, 0.05
"""Largest number of modes of patterns that change, and least part by which a further object must raise what is explained: two patterns
explain the change of a single one, too. It may therefore have one mode more. Steady patterns must explain more than those that change."""

QUICK, QUICK_FREQUENCIES = 1e4, 1300
"""Paths are sought at as few frequencies as raise the logarithm of the likelihood by this along the path of a single object, and at no
fewer than a number of them, or half of it, because they are evenly spaced."""

MAX_PATTERNS = 0.5
"""Largest number of patterns of objects and their interference, over the number of frames in the longest block."""

PITCH, REACH = 1.5, 4
"""Pitch of the velocities at which an object is sought beside another, in half grains over the largest distance of frames, and their
greatest difference in pitches."""

CLIMB = 5.0
"""Largest change of a velocity in a round of the search with patterns that fade, in half grains over the largest distance of frames."""

STARTS = 3
"""Numbers of paths from the candidates, from beside other objects, and of pairs, that are moved to their maxima; and how many of these, one
fewer for each further object, are moved together with their interference."""


class Several:
    """Objects in spectra (frames, R, C), with paths (frames, 2), by the frequencies of a band."""

    def __init__(self, spectra: np.ndarray, band: Band, lags: Sequence[int], alone: np.ndarray) -> None:
        """Take distances of frames, the largest first, and the path of a single object, (frames, 2).

        Frames that are strange along it do not count in the likelihood: they look like a further object.
        """
        whole_band, band = band, central_lobe(band)
        self._fits_interference = is_fitted(whole_band, band)
        self._shared = Explained(spectra, band, lags)
        used = ~are_strange(spectra, band, alone)
        self._whole = Likelihood(spectra, band, WHOLE, used)
        whole = self._whole.frequencies
        wanted = max(QUICK_FREQUENCIES, whole * QUICK / max(self.rise([alone]), 1.0))
        self._quick = Likelihood(spectra, band, len(spectra) * int(wanted), used) if wanted < whole else self._whole
        self._fading = partial(FadingLikelihood, spectra, band, used=used)
        self.band, self._lag, self._step = band, lags[0], 0.5 * band.grain_pixels / lags[0]
        self._numbers, self._climb = np.arange(len(spectra))[:, None], CLIMB * self._step

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
        begun = list(self._begun(known, candidates))
        found = [apart(paths) for paths in map(self.settle, begun) if self._are_objects(known, paths)]
        if not found:
            return None
        before = find_interference(self._quick, known) if self._may_interfere(len(known)) else apart(known)
        if self._may_interfere(len(known) + 1):
            found = self._interfering(known, found)
        limits = self._limits(before)
        found.sort(key=lambda one: self.rise(one.tracks), reverse=True)
        likely = next((one for one in found if self._are_likely(one, *limits)), None)
        return likely and self._most_likely(known, likely, begun[:STARTS])

    def _most_likely(self, known: Sequence[np.ndarray], found: Together, begun: Sequence[list[np.ndarray]]) -> list[np.ndarray]:
        """Return the paths of known objects and of a further one: those found, unless patterns change more than they interfere, as far as
        interference is fitted. Then the likelihood of patterns that fade is maximised, from them and from begun paths."""
        if not len(found.between) or max(self._rises(found.paths, MODES)[1:]) < self.rise(found.tracks):
            return found.paths
        sought = self._fading(SOUGHT)
        climbed, _ = max((climb(sought, one, self._climb) for one in (found.paths, *begun)), key=lambda one: one[1])
        climbed, _ = climb(self._fading(FINE), climbed, self._climb)
        return climbed if self._are_objects(known, climbed) else found.paths

    def _may_interfere(self, objects: int) -> bool:
        """Return whether the interference of some objects is fitted: each two of them have two patterns more."""
        return self._fits_interference and objects**2 <= MAX_PATTERNS * self._whole.longest_block

    def _interfering(self, known: Sequence[np.ndarray], found: Sequence[Together]) -> list[Together]:
        """Return known objects and a further one with their interference, near those found without it that are the most likely."""
        begun = [begin_interference(self._quick, one.paths) for one in found]
        begun.sort(key=lambda one: self._quick.rise(one.tracks), reverse=True)
        likely = map(self._maximise, begun[: max(1, STARTS + 1 - len(known))])
        return [one for one in likely if self._are_objects(known, one.paths)]

    def _maximise(self, begun: Together) -> Together:
        """Return objects at the maximum of their likelihood, if all frequencies say that they are likelier than begun ones."""
        best = maximise(self._quick, begun, self._step)
        return best if self.rise(best.tracks) > self.rise(begun.tracks) else begun

    def _limits(self, known: Together) -> tuple[float, float]:
        """Return what known objects explain by patterns that change, or by steady interference; and what with one mode more, or by
        interference that changes."""
        changing = self._rises(known.paths, MODES + 1)
        with_interference = self._rises(known.tracks, 2) if len(known.between) else []
        return max(changing[:MODES] + with_interference[:1]), max(changing + with_interference)

    def _rises(self, tracks: Sequence[np.ndarray], most: int) -> list[float]:
        """Return by how much patterns of 1, 2, ... modes along tracks raise the logarithm of the likelihood of all frames."""
        return [self._whole.rise(tracks, modes) for modes in range(1, most + 1)]

    def _are_likely(self, together: Together, steady: float, changing: float) -> bool:
        """Return whether objects explain more than patterns of known ones that change, or by interference; see `_limits`."""
        found, paths = self.rise(together.paths), together.paths
        # The model does not explain all interference of two known objects.
        least = (1.0 if len(paths) == 2 else 1.0 + MIN_GAIN) * max(changing, found) + self.cells
        if self.rise(together.tracks) > least and self._moves_as_neither(together):
            return True
        changed = max(self._rises(paths, MODES))
        return found > steady + self.cells or changed > (1.0 + MIN_GAIN) * changing + self.cells

    def _moves_as_neither(self, together: Together) -> bool:
        """Return whether the interference of each two objects parts from both: along the path of one, it is a pattern that swings."""
        ways = [way_apart(*pair, self._lag) for pair in combinations(together.paths, 2)]
        parts = [min(share, 1.0 - share) * way for (share, _), way in zip(together.between, ways, strict=False)]
        return all(part > self.band.grain_pixels for part in parts)

    def _begun(self, known: Sequence[np.ndarray], candidates: Sequence[np.ndarray]) -> Iterator[list[np.ndarray]]:
        """Yield paths of known objects and of a further one, near the maximum of their likelihood; or of two in place of a known one."""
        patterns = [self._quick.pattern(one) for one in known]
        places = [PITCH * np.array(one) for one in product(range(-REACH, REACH + 1), repeat=2) if 0 < np.hypot(*one) <= REACH]
        beside = [path + self._step * self._numbers * place for path in known for place in places]

        def likely(paths: Sequence[np.ndarray]) -> list[np.ndarray]:
            values = [self._quick.of([*patterns, self._quick.pattern(one)]) for one in paths]
            return self._distinct([paths[index] for index in np.argsort(values)[::-1]])

        chosen = likely(candidates)
        yield from ([*known, one] for one in chosen[:STARTS] + likely(beside)[:STARTS])
        pairs = combinations(chosen[: 2 * STARTS], 2)
        instead = [[*(other for other in known if other is not one), *pair] for pair in pairs for one in known]
        yield from sorted(instead, key=self._quick.rise, reverse=True)[:STARTS]

    def _distinct(self, paths: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return those paths (frames, 2) that differ from all before them."""
        found: list[np.ndarray] = []
        for path in paths:
            if all(are_distinct(path, one, self._lag, self.band) for one in found):
                found.append(path)
        return found

    def _are_objects(self, known: Sequence[np.ndarray], paths: Sequence[np.ndarray]) -> bool:
        """Return whether paths are apart, and those of bright objects that explain more than known ones of what distant frames share."""
        (_, before), (powers, after) = self._shared.fit(known), self._shared.fit(paths)
        explains = after > before + self._shared.cells  # twice what noise would
        distinct = (are_distinct(*pair, self._lag, self.band) for pair in combinations(paths, 2))
        least = MIN_RELATIVE_HEIGHT if self._fits_interference else MIN_RELATIVE_POWER
        return bool(explains and powers.min() > least * powers.max() and all(distinct))
