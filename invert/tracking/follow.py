"""Exact path of one object: each frame is registered to the sum of the frames around it, moved to their own positions.

The speckle stays the same while the object moves by a fraction of a grain of its illumination. Within this reach, the sum of M frames shows
it with M times less noise than one, and the error of a frame's position approaches that for a known pattern. Frames too dim to be
registered alone are summed in groups of two, four and so on, as they move.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import interp1d

from invert.tracking.band import Band
from invert.tracking.light import light_of_frames
from invert.tracking.register import register
from invert.tracking.shifts import MIN_SIGNIFICANCE, move_back
from invert.tracking.smoothing import PathNoise
from invert.tracking.start import Start
from invert.tracking.strange import are_strange

MIN_GROUP_SIGNIFICANCE = 5.0
"""Median significance of a group of frames in its surroundings from which it is registered on its own."""


@dataclass(frozen=True)
class Followed:
    """Path of an object.

    Attributes:
        path: position of its speckle in each frame from the first, (frames, 2) pixels.
        error: standard error of each position of the speckle, (frames, 2).
        frames_per_group: number of frames that were registered together, or distance of positions between which the path is straight.
        power: power of its speckle, (R, C).
        significance: median significance of a group in its surroundings; 0 where none was measured.
        noise: noise of the path; of variance zero for an approximate one.
        fading: mean square of the way from frame to frame over the square of that in which the likeness of frames falls to 1 / e; 0 if it
            is not measured.
        in_common: share of all power that frames 1, 2, ... apart have in common by one of several objects.
        shortened: largest part by which an open shutter shortens a step.
        interpolated: frames that share nothing with those beside them, whose positions are interpolated.
    """

    path: np.ndarray
    error: np.ndarray
    frames_per_group: int
    power: np.ndarray
    significance: float = 0.0
    noise: PathNoise = field(default_factory=PathNoise)
    fading: float = 0.0
    in_common: np.ndarray = field(default_factory=lambda: np.zeros(0))
    shortened: float = 0.0
    interpolated: tuple[int, ...] = ()


def follow(spectra: np.ndarray, band: Band, start: Start) -> Followed:
    """Return the path of a single object near an approximate one, from spectra (frames, R, C); where it cannot be made exact, that one."""
    best, length, longest = None, 1, 1
    while best is None or (best.significance < MIN_GROUP_SIGNIFICANCE and length <= longest):
        found = _follow_groups(spectra, band, start.path, length)
        longest = found.noise.reach if length == 1 else longest
        if best is None or found.significance > best.significance:
            best = found
        length *= 2
    if best.significance < MIN_GROUP_SIGNIFICANCE:
        return approximate(start, band)
    return best


def approximate(start: Start, band: Band) -> Followed:
    """Return an approximate path as it is.

    Its error is the radius of a grain, or the sum of the errors of all blocks: the displacement of a block over `lag` frames is known to
    that radius over the least significance. Beside other objects, whose interference displaces all blocks alike, it is known to half the
    radius only.
    """
    numbers = np.arange(len(start.path))
    of_block = start.frames_per_block / (start.lag * MIN_SIGNIFICANCE)
    error = np.maximum(1.0, of_block * (numbers / start.frames_per_block) ** 0.5)
    if start.lag > 1:
        error = np.maximum(error, 0.5 * numbers / start.lag)
    error *= band.grain_pixels
    error[0] = 0.0
    return Followed(start.path, np.stack([error, error], 1), start.frames_per_block, band.signal)


def _follow_groups(spectra: np.ndarray, band: Band, path: np.ndarray, length: int) -> Followed:
    """Return the path from groups of `length` frames.

    Within a group, the approximate path gives the motion about its mean.
    """
    groups = np.array_split(np.arange(len(path)), max(2, len(path) // length))
    middles = np.array([group.mean() for group in groups])
    means = np.stack([path[group].mean(0) for group in groups])
    sums = spectra
    if len(groups) < len(path):
        sums = np.stack([move_back(spectra[group], band, path[group] - path[group].mean(0)).sum(0) for group in groups])
    of_group = replace(band, signal=band.signal * length**2, floor=band.floor * length)
    registered = register(sums, of_group, means, light_of_frames(sums, of_group))
    numbers = np.arange(len(path))
    strange = are_strange(sums, of_group, registered.places) if length == 1 else np.zeros(len(groups), bool)
    if strange.any():
        sums, middles, means = sums[~strange], middles[~strange], means[~strange]
        registered = register(sums, of_group, means, light_of_frames(sums, of_group))
        path = interp1d(middles, means, axis=0, fill_value="extrapolate")(numbers)
    found = path + interp1d(middles, registered.places - means, axis=0, fill_value="extrapolate")(numbers)
    errors = np.stack([np.interp(numbers, middles, error) for error in registered.error.T], 1)
    from_first = np.hypot(errors, errors[0])
    from_first[0] = 0.0
    noise = PathNoise(registered.of_pair, registered.reach, length)
    return Followed(
        found - found[0],
        from_first,
        length,
        band.signal,
        registered.significance,
        noise,
        interpolated=tuple(np.flatnonzero(strange).tolist()),
    )
