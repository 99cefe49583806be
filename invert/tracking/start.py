"""Approximate paths of objects: maxima of the cross-correlation of frames some distance apart, summed over blocks of frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from correlograph.errors import InputError
from invert.tracking.band import Band
from invert.tracking.maxima import MIN_RELATIVE_HEIGHT, Crossed, correlate, maxima
from invert.tracking.parts import on_all_cores
from invert.tracking.shares import Shares, mean_overlap, whole_height
from invert.tracking.shifts import MIN_SIGNIFICANCE, weight_of

MAX_BLOCKS = 32
"""Number of blocks of frames in which objects are sought first."""

MAX_PEAKS = 4

SCALES = (1.0, 0.85, 0.7, 0.55)
"""Distances of frames over the largest, at which an object must have moved in proportion."""

MIN_RIVAL_HEIGHT = 0.3
"""The least height of a maximum over that of the highest at which its object could be the brightest of all blocks."""

MEAN_SCALE = sum(SCALES) / len(SCALES)

MAX_JUMP_GRAINS = 4.0
"""Largest change of the displacement from one block to the next that still counts as one object."""

MAX_LIKENESS_OF_WAYS = 0.25
"""Largest autocorrelation of the speckle at the difference of the ways of two objects."""

MIN_PRESENCE = 0.7
"""Share of the time in which an object must appear, and be apart from others."""


@dataclass(frozen=True)
class Start:
    """An object at the beginning of the search.

    Attributes:
        path: approximate position of its speckle in each frame, (frames, 2) pixels.
        significance: height of its maximum in the sum over all blocks, each at its own displacement, in standard deviations.
        share: share of the power of the speckle that frames `lag` apart have in common by it.
        frames_per_block: number of frames in the blocks from which the path was found.
        lag: distance of the frames by whose displacement it was found.
        is_continuous: whether single frames show that the path does not jump.
        jumps: number of frames at which the path does not go on as the motion of most frames would.
    """

    path: np.ndarray
    significance: float
    share: float
    frames_per_block: int = 1
    lag: int = 1
    is_continuous: bool = False
    jumps: int = 0


def find_brightest(spectra: np.ndarray, band: Band) -> Start:
    """Return the brightest object by consecutive frames, from spectra (frames, R, C).

    There are `MAX_BLOCKS` blocks of frames, between which the motion may change, or, if they show no object, blocks as short as the light
    allows. Raises InputError if the whole capture shows no common motion.
    """
    pairs = len(spectra) - 1
    doubled = (2**power for power in range(pairs.bit_length()))
    for length in dict.fromkeys([max(1, pairs // MAX_BLOCKS), *doubled]):
        found, is_clear = paths_at(spectra, band, 1, length, MIN_RIVAL_HEIGHT)
        if found and is_clear:
            return found[0]
    weight = weight_of(band, 0.0)
    total = (spectra[:-1].conj() * spectra[1:]).sum(0)
    best = float(correlate(total, band, weight)[0].max()) / (weight.deviation * pairs**0.5)
    needed = f"{best:.1f} standard deviations of the summed cross-correlation, {MIN_SIGNIFICANCE:g} are needed"
    if best > MIN_SIGNIFICANCE:
        needed = "light in common in too few of the frames"
    remedy = "keep the laser at rest, shorten the interval, or add light"
    raise InputError("frames", "speckle that moves as a whole", needed, remedy)


def replace_path(start: Start, spectra: np.ndarray, band: Band, path: np.ndarray) -> Start:
    """Return an object with another path (frames, 2), and the share and the significance of consecutive frames along it."""
    shares = Shares(spectra, band)
    share = shares.along(path, 1)
    return replace(start, path=path, share=min(1.0, share), significance=share / shares.noise(len(path) - 1))


def distances(lag: int) -> np.ndarray:
    """Return the distances of frames, the largest first, at which an object is sought together."""
    return np.unique(np.round(lag * np.array(SCALES)).astype(int))[::-1]


def way_apart(one: np.ndarray, other: np.ndarray, lag: int) -> float:
    """Return the median difference of the displacements along two paths (frames, 2) over `lag` frames, in pixels."""
    relative = one - other
    return float(np.median(np.linalg.norm(relative[lag:] - relative[:-lag], axis=1)))


def are_apart(one: np.ndarray, other: np.ndarray, lag: int, band: Band) -> bool:
    """Return whether maxima at the displacements along two paths over up to `lag` frames are those of two objects; see `Band.are_apart`.

    They must be at the median displacement, which has little noise, and most of the time: a path that meets that of an object now and then
    explains what this object does then.
    """
    relative = one - other
    steps = MEAN_SCALE * (relative[lag:] - relative[:-lag])
    return bool(band.are_apart(np.median(steps, axis=0)) and band.are_apart(steps).mean() >= MIN_PRESENCE)


def are_distinct(one: np.ndarray, other: np.ndarray, lag: int, band: Band) -> bool:
    """Return whether the speckle that moves along two paths (frames, 2) parts within `lag` frames: at the full difference of their ways and
    beyond, its autocorrelation is low."""
    relative = one - other
    return bool(band.likeness_beyond(np.median(relative[lag:] - relative[:-lag], axis=0)) < MAX_LIKENESS_OF_WAYS)


def paths_at(
    spectra: np.ndarray, band: Band, lag: int, length: int, min_height: float = MIN_RELATIVE_HEIGHT
) -> tuple[list[Start], bool]:
    """Return the objects by the displacement of frames that are up to `lag` apart, in blocks of `length` pairs, the brightest first, and
    whether nearly all blocks show one. `min_height` is that of a maximum over the highest."""
    pairs, weight = len(spectra) - lag, weight_of(band, 0.0)
    lags = distances(lag)
    blocks = np.array_split(np.arange(pairs), max(1, pairs // length))

    def peaks_of(block: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, float]:
        cross = np.zeros((len(lags), *band.signal.shape), np.complex64)
        own = np.zeros(band.signal.shape, np.float32)
        for number in block:
            for total, one in zip(cross, lags, strict=True):
                first = spectra[number + (lag - one) // 2]
                total += first.conj() * spectra[number + (lag - one) // 2 + one]
            own += first.real**2 + first.imag**2
        own /= len(block)
        crossed = Crossed(cross / len(block), lags / lag, np.maximum(own - band.floor, 0.0), len(block))
        return *maxima(crossed, band, weight, MAX_PEAKS, min_height), len(block), float((weight.values * own).sum())

    found = on_all_cores(peaks_of, blocks)
    middles = np.array([block.mean() + 0.5 * lag for block in blocks])
    starts = []
    for chain in _chains(found, MAX_JUMP_GRAINS * band.grain_pixels):
        known = np.array(sorted(chain))
        steps = np.array([found[block][0][chain[block]] for block in known])
        heights = np.array([found[block][1][chain[block]] for block in known])
        sizes = np.array([found[block][3] for block in known])
        clear = np.array([found[block][2][chain[block]] for block in known]) * sizes**0.5
        at = np.arange(len(spectra) - 1) + 0.5
        each = np.stack([np.interp(at, middles[known], steps[:, axis]) for axis in (0, 1)], 1) / lag
        path = np.concatenate([np.zeros((1, 2)), np.cumsum(each, 0)])
        used = sizes.sum()
        own = float(np.dot([found[block][4] for block in known], sizes)) / used
        whole = used * whole_height(own, used, band, weight) * mean_overlap(lag * each, band)
        share = float((heights * sizes).sum()) / whole
        starts.append(Start(path, float(clear.sum() / used**0.5), float(min(share, 1.0)), length, lag))
    return sorted(starts, key=lambda one: -one.share), bool(np.mean([len(places) > 0 for places, *_ in found]) > 0.9)


def _chains(found: list[tuple[np.ndarray, np.ndarray, np.ndarray, int, float]], jump: float) -> list[dict[int, int]]:
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
