"""Objects and their approximate paths: maxima of the cross-correlation of consecutive frames, summed over blocks of frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from correlograph.errors import InputError
from invert.tracking.shifts import MIN_SIGNIFICANCE, correlate, heights_at, peaks, weight_of
from invert.tracking.spectra import Band

MAX_BLOCKS = 32
"""Number of blocks of frames in which objects are sought first."""

LAGS = (1, 2, 4, 8, 16)
"""Distances of the frames that are compared."""

MIN_PERSISTENCE = 0.2
"""Share of the common speckle of consecutive frames that frames two apart must show."""

STILL_CLEAR = 0.7
"""Significance of the faintest object over the highest at any distance of frames, above which it counts as clear."""

MAX_OBJECTS = 4
MAX_JUMP_GRAINS = 4.0
"""Largest change of the displacement from one block to the next that still counts as one object."""

MIN_PRESENCE = 0.7
"""Share of the blocks in which an object must appear."""


@dataclass(frozen=True)
class Start:
    """An object at the beginning of the search.

    Attributes:
        path: approximate position of its speckle in each frame, (frames, 2) pixels.
        significance: of its maximum in the sum over all blocks, each at its own displacement, in standard deviations.
        share: share of the power of the speckle that consecutive frames have in common by it.
        frames_per_block: number of frames in the blocks from which the path was found.
    """

    path: np.ndarray
    significance: float
    share: float
    frames_per_block: int = 1


def find_objects(spectra: np.ndarray, band: Band) -> list[Start]:
    """Return the objects of a capture, the brightest first.

    Args:
        spectra: (frames, R, C).

    Frames further apart tell objects of little different speed from one another. Of the distances that show most objects, the largest is
    used at which the faintest is still clear; a single object is followed by consecutive frames.
    Raises InputError if the whole capture shows no common motion.
    """
    best: list[Start] = []
    clearest = 0.0
    for lag in (one for one in LAGS if one < max(2, len(spectra) // 2)):
        try:
            found = [one for one in _objects_at(spectra, band, lag) if _persists(one, spectra, band)]
        except InputError:
            if best:
                break
            raise
        faintest = min((one.significance for one in found), default=0.0)
        if len(found) > len(best):
            best, clearest = found, faintest
        elif len(found) == len(best) > 1 and faintest > STILL_CLEAR * clearest:
            best, clearest = found, max(faintest, clearest)
    if not best:
        expected, remedy = "speckle that moves as a whole", "keep the laser and the camera at rest"
        raise InputError("frames", expected, "displacements that do not continue from frame to frame", remedy)
    return best


def _persists(one: Start, spectra: np.ndarray, band: Band) -> bool:
    """Return whether frames two apart show an object at its path, too. A camera that shakes back and forth looks like two objects that
    move in opposite directions, until then."""
    return len(spectra) < 4 or share_along(spectra, band, one.path, 2) > MIN_PERSISTENCE * share_along(
        spectra, band, one.path, 1
    )


def share_along(spectra: np.ndarray, band: Band, path: np.ndarray, lag: int) -> float:
    """Return the share of the speckle that frames `lag` apart have in common along a path (frames, 2)."""
    steps, weight = path[lag:] - path[:-lag], weight_of(band, 0.0)
    alike = heights_at(spectra[:-lag].conj() * spectra[lag:], band, weight, steps)
    overlap = np.prod(1.0 - np.abs(steps) / np.array(band.shape), axis=1).mean()
    return float(alike.mean() / (weight.full * max(overlap, 0.1)))


def _objects_at(spectra: np.ndarray, band: Band, lag: int) -> list[Start]:
    """Return the objects by the displacement of frames that are `lag` apart. There are `MAX_BLOCKS` blocks of frames, between which the
    motion may change; if they show no object, blocks as short as the light allows."""
    pairs, weight = len(spectra) - lag, weight_of(band, 0.0)
    cross = spectra[:-lag].conj() * spectra[lag:]
    length, best = max(1, pairs // MAX_BLOCKS), 0.0
    is_first = length > 1
    while True:
        blocks = np.array_split(np.arange(pairs), max(1, pairs // length))
        found = []
        for block in blocks:
            total, deviation = cross[block].sum(0), weight.deviation * len(block) ** 0.5
            own = np.maximum((np.abs(spectra[block]) ** 2).sum(0) - len(block) * band.floor, 0.0)
            found.append((*peaks(total, own, band, weight, deviation, MAX_OBJECTS), len(block)))
            if len(blocks) == 1:
                best = float(correlate(total, band, weight)[0].max()) / deviation
        chains = _chains(found, MAX_JUMP_GRAINS * band.grain_pixels)
        if chains and np.mean([len(places) > 0 for places, *_ in found]) > 0.9:
            break
        if len(blocks) == 1:
            needed = f"{best:.1f} standard deviations of the summed cross-correlation, {MIN_SIGNIFICANCE:g} are needed"
            remedy = "keep the laser at rest, shorten the interval, or add light"
            raise InputError("frames", "speckle that moves as a whole", needed, remedy)
        length, is_first = (1 if is_first else 2 * length), False
    middles = np.array([block.mean() + 0.5 * lag for block in blocks])
    starts = []
    for chain in chains:
        known = np.array(sorted(chain))
        steps = np.array([found[block][0][chain[block]] for block in known])
        heights = np.array([found[block][1][chain[block]] for block in known])
        clear = np.array([found[block][2][chain[block]] * found[block][3] ** 0.5 for block in known])
        at = np.arange(len(spectra) - 1) + 0.5
        each = np.stack([np.interp(at, middles[known], steps[:, axis]) for axis in (0, 1)], 1) / lag
        path = np.concatenate([np.zeros((1, 2)), np.cumsum(each, 0)])
        used = sum(found[block][3] for block in known)
        overlap = np.prod(1.0 - np.abs(lag * each) / np.array(band.shape), axis=1).mean()
        share = heights.sum() / (used * weight.full * max(overlap, 0.1))
        starts.append(Start(path, float(clear.sum() / used**0.5), float(min(share, 1.0)), length))
    return sorted(starts, key=lambda one: -one.share)


def _chains(found: list[tuple[np.ndarray, np.ndarray, np.ndarray, int]], jump: float) -> list[dict[int, int]]:
    """Return, for each object, the maximum that belongs to it in each block: {block: index}."""
    chains: list[dict[int, int]] = []
    for block, (places, *_) in enumerate(found):
        free = set(range(len(chains)))
        for index, place in enumerate(places):
            last = {one: found[max(chains[one])][0][chains[one][max(chains[one])]] for one in free}
            near = min(last, key=lambda one: float(np.linalg.norm(last[one] - place)), default=None)
            if near is not None and np.linalg.norm(last[near] - place) <= jump:
                chains[near][block] = index
                free.discard(near)
            else:
                chains.append({block: index})
    return [chain for chain in chains if len(chain) >= MIN_PRESENCE * len(found)]
