"""Objects and their approximate paths: maxima of the cross-correlation of consecutive frames, summed over blocks of frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from correlograph.errors import InputError
from invert.tracking.shifts import MIN_SIGNIFICANCE, correlate, peaks, weight_of
from invert.tracking.spectra import Band

MOST_OBJECTS = 4
MAX_JUMP_GRAINS = 4.0
"""Largest change of the displacement from one block to the next that still counts as one object."""

FADED = 0.5
"""Share of the blocks in which an object must appear."""


@dataclass(frozen=True)
class Start:
    """An object at the beginning of the search.

    Attributes:
        path: approximate position of its speckle in each frame, (frames, 2) pixels.
        significance: of its maximum in the sum over all blocks, each at its own displacement, in standard deviations.
        share: share of the power of the speckle that consecutive frames have in common by it.
    """

    path: np.ndarray
    significance: float
    share: float


def find_objects(spectra: np.ndarray, band: Band) -> list[Start]:
    """Return the objects of a capture, the brightest first.

    Args:
        spectra: (frames, R, C).

    Blocks are as short as the light allows, so that the motion may change from one to the next. Raises InputError if the whole capture
    shows no common motion.
    """
    pairs, weight = len(spectra) - 1, weight_of(band, 0.0)
    cross = spectra[:-1].conj() * spectra[1:]
    length, best = 1, 0.0
    while True:
        blocks = np.array_split(np.arange(pairs), max(1, pairs // length))
        found = []
        for block in blocks:
            height, pitch = correlate(cross[block].sum(0), band, weight)
            found.append((*peaks(height, pitch, band, weight.deviation * len(block) ** 0.5, MOST_OBJECTS), len(block)))
            best = max(best, float(height.max()) / (weight.deviation * len(block) ** 0.5))
        seen = np.array([len(places) > 0 for places, _, _ in found])
        if seen.mean() > 0.9:
            break
        if len(blocks) == 1:
            needed = f"{best:.1f} standard deviations of the summed cross-correlation, {MIN_SIGNIFICANCE:g} are needed"
            remedy = "keep the laser at rest, shorten the interval, or add light"
            raise InputError("frames", "speckle that moves as a whole", needed, remedy)
        length *= 2
    middles = np.array([block.mean() + 0.5 for block in blocks])
    starts = []
    for chain in _chains(found, MAX_JUMP_GRAINS * band.grain_pixels):
        known = np.array(sorted(chain))
        steps = np.array([found[block][0][chain[block]] for block in known])
        heights = np.array([found[block][1][chain[block]] * found[block][2] ** 0.5 for block in known])
        each = np.stack([np.interp(np.arange(pairs) + 0.5, middles[known], steps[:, axis]) for axis in (0, 1)], 1)
        path = np.concatenate([np.zeros((1, 2)), np.cumsum(each, 0)])
        used = sum(found[block][2] for block in known)
        overlap = np.prod(1.0 - np.abs(each) / np.array(band.shape), axis=1).mean()
        share = heights.sum() * weight.deviation / (used * weight.full * max(overlap, 0.1))
        starts.append(Start(path, float(heights.sum() / used**0.5), float(min(share, 1.0))))
    return sorted(starts, key=lambda one: -one.share)


def _chains(found: list[tuple[np.ndarray, np.ndarray, int]], jump: float) -> list[dict[int, int]]:
    """Return, for each object, the maximum that belongs to it in each block: {block: index}."""
    chains: list[dict[int, int]] = []
    for block, (places, _, _) in enumerate(found):
        free = set(range(len(chains)))
        for index, place in enumerate(places):
            last = {one: found[max(chains[one])][0][chains[one][max(chains[one])]] for one in free}
            near = min(last, key=lambda one: float(np.linalg.norm(last[one] - place)), default=None)
            if near is not None and np.linalg.norm(last[near] - place) <= jump:
                chains[near][block] = index
                free.discard(near)
            else:
                chains.append({block: index})
    return [chain for chain in chains if len(chain) >= FADED * len(found)]
