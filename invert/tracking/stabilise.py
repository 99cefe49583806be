"""Frames that follow an object: consecutive ones, moved back along the path of its speckle, are added to one of a longer exposure.

While an object moves by a fraction of a grain of its illumination, its speckle stays the same. The sum of g frames that follow it has g
times the light of one, as if the shutter had been open g times as long and the object at rest. Faint light gains the root of g in r*r;
bright light gains nothing, and too large a g adds patterns that no longer agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from correlograph.errors import InputError, memory_bytes
from correlograph.files.capture import Capture
from correlograph.lags import LAG_SIDE
from invert.measure.contrast import Contrast, signal_sum
from invert.measure.estimate import Estimate, estimate_from_frames
from invert.measure.preparation import mean_frame
from invert.measure.spectrum import read_measurement
from invert.request import Request
from invert.tracking.numbers import frame_numbers
from invert.tracking.pursuit import HALF
from invert.tracking.spectra import DIM_FRAMES_FOR_POWER
from invert.tracking.track import Track
from invert.tracking.tracker import track
from invert.tracking.travel import Travel, find_travel, may_travel
from radiometry.estimation.hot_pixels import HotPixels
from radiometry.estimation.third_moment import FilteredFrames
from radiometry.transfer import gaussian_transfer

MIN_GROUPS = 2
"""Minimum number of groups that are left."""

FRAMES_FOR_SIZE = 64
"""Number of frames, in the middle of the capture, by which the size of a group is chosen."""

MIN_BLUR = 0.01
"""Largest part that the blur of a path takes from r*r at any lag, below which it is left out."""

MIN_FRAMES_OF_PATH = 6
"""Number of frames from which the path of a camera that shakes looks different from that of an object."""


@dataclass(frozen=True)
class Stabilised:
    """Frames that follow an object.

    Attributes:
        capture: one frame for each group.
        size: number of frames in a group.
        middle_frame: number of the frame in the middle of each group, (groups,).
        travel: mean displacement from frame to frame, of each object; None if the speckle does not travel.
        track: path of the object; None if none was found. The first of several objects holds the others; frames then follow none.
        obstacle: why a speckle that travels could not be followed.
        blur_pixels: standard deviation of the blur of a group by the error of the path and by whole pixels, (rows, columns).
    """

    capture: Capture
    size: int
    middle_frame: np.ndarray
    travel: Travel | None = None
    track: Track | None = None
    obstacle: str = ""
    blur_pixels: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def at_rest(
        cls, capture: Capture, travel: Travel | None = None, track: Track | None = None, obstacle: str = ""
    ) -> Stabilised:
        """Return the frames as they are."""
        return cls(capture, 1, np.arange(float(len(capture.frames))), travel, track, obstacle)

    @property
    def objects(self) -> tuple[Track, ...]:
        """Path of each object, the brightest first."""
        return () if self.track is None else (self.track, *self.track.others)

    @property
    def may_shake(self) -> bool:
        """Whether what travels may be static light before a camera that shakes: few frames do not show that a path is smooth."""
        return self.travel is not None and len(self.capture.frames) * self.size < MIN_FRAMES_OF_PATH

    def path_of(self, number: int) -> Track | None:
        """Return the path of an object alone, 1 for the brightest; None if none was found to move."""
        return replace(self.objects[number - 1], others=()) if self.objects else None

    @property
    def notes(self) -> list[str]:
        """Notes for a result."""
        if self.travel is None:
            return []
        pooled = "frames were pooled without subtraction of what they share"
        if self.size > 1:
            pooled = f"groups of {self.size} frames were added along the path of the speckle"
        notes = [self.travel.describe()]
        if len(self.travel.steps_pixels) > 1 and self.obstacle:
            notes.append(f"all objects are shown together, because their paths were not found ({self.obstacle})")
        if self.track is not None and self.track.interpolated:
            notes.append(self.track.of_strange_frames)
        return notes + ([pooled] if len(self.objects) < 2 else [])


def follow_travel(capture: Capture, filtered: FilteredFrames | None, groups: int = MIN_GROUPS) -> Stabilised:
    """Return frames that follow a speckle that travels; frames as they are if it does not.

    Args:
        filtered: band-limited frames of an estimate from the capture.
        groups: minimum number of groups that are left.
    """
    if filtered is None or not may_travel(filtered.spectra) or (travel := find_travel(capture)) is None:
        return Stabilised.at_rest(capture)
    frame_numbers(capture)  # refuses files that are not in order
    try:
        path = track(capture)
    except InputError as error:  # too dim, or too many frames for the memory
        return Stabilised.at_rest(capture, travel, obstacle=str(error))
    return Stabilised.at_rest(capture, travel, path) if path.others else stabilise(capture, path, groups)


def mean_pattern(capture: Capture) -> Capture:
    """Return a capture of one frame: the sum of frames of one pattern, moved back along its path; their mean, if it stays at rest as far as
    the path is known, or if hardly any pixels would be left."""
    try:
        path = track(replace(capture, names=()))  # their order does not matter
        moved = _Adder(capture).add(path.smooth_path_pixels, [range(len(capture.frames))])
    except InputError:
        return mean_frame(capture)
    return mean_frame(capture) if path.is_at_rest or min(moved.frames[0].shape) < LAG_SIDE else moved


def stabilise(capture: Capture, path: Track, least: int = MIN_GROUPS) -> Stabilised:
    """Return a capture whose frames follow a path. The size of a group is the power of two at which r*r is most significant, up to the
    distance at which frames along the path share less than half: beyond, the path may be wrong."""
    count, pixels = len(capture.frames), path.smooth_path_pixels
    longest = path.fading[0] if path.fading and path.fading[0] > 1 and path.fading[1] < HALF else count
    first = max(0, (count - FRAMES_FOR_SIZE) // 2)
    some = range(first, min(count, first + FRAMES_FOR_SIZE))
    best, clearest, size, adder = 1, -np.inf, 1, _Adder(capture)
    while len(some) // size >= MIN_GROUPS and count // size >= least and size <= longest:
        found = _detection(adder, pixels, _groups(some, size))
        if found <= clearest:
            break
        best, clearest, size = size, found, 2 * size
    added = capture
    while best > 1:
        try:
            added = adder.add(pixels, _groups(range(count), best))
            break
        except InputError:  # the object is faster elsewhere
            best //= 2
    groups = _groups(range(count), best)
    middles = np.array([0.5 * (one[0] + one[-1]) for one in groups])
    rows, columns = np.hypot(path.error_in_groups(best), _rounding(pixels, groups)) if best > 1 else (0.0, 0.0)
    travel = Travel(path.step_pixels[None], path.share)
    return Stabilised(added, best, middles, travel, path, blur_pixels=(float(rows), float(columns)))


def _rounding(path: np.ndarray, groups: Sequence[range]) -> np.ndarray:
    """Return the rms of what moving groups of frames by whole pixels leaves of a path (frames, 2), (2,)."""
    moves = [path[one] - path[one[len(one) // 2]] for one in groups]
    return np.sqrt(np.mean([(one - np.rint(one)).var(0) for one in moves], 0))


def _detection(adder: _Adder, path: np.ndarray, groups: Sequence[range]) -> float:
    """Return the significance of r*r from groups of frames, in standard deviations."""
    try:
        estimate = estimate_from_frames(adder.add(path, groups), Request(mean_model="pooled"))
    except InputError:  # too small after the edges were cut off
        return -np.inf
    return read_measurement(estimate.values, estimate.quantisation, estimate.transfer).detection


def estimate_along(capture: Capture, request: Request, blur_pixels: tuple[float, float]) -> Estimate:
    """Estimate r*r from groups of frames along a path whose error within a group blurs them."""
    estimate = estimate_from_frames(capture, request)
    if estimate.record is None:
        return estimate
    blur = gaussian_transfer(estimate.lag_grid.steps, estimate.record.grid.patch_shape, blur_pixels)
    if blur.min() > 1.0 - MIN_BLUR:
        return estimate
    transfer = blur if estimate.transfer is None else estimate.transfer * blur
    record, contrast = estimate.record, estimate.record.contrast
    if contrast is not None:
        before, after = (signal_sum(read_measurement(estimate.values, transfer=one)) for one in (estimate.transfer, transfer))
        gain = after / before
        record = replace(record, contrast=Contrast(gain * contrast.square, gain * contrast.error))
    return replace(estimate, transfer=transfer, path_blur_pixels=blur_pixels, record=record)


def _groups(numbers: Sequence[int], size: int) -> list[range]:
    """Return consecutive groups of frames; those at the end that fill no group are left out."""
    return [range(start, start + size) for start in range(numbers[0], numbers[-1] + 2 - size, size)]


class _Adder:
    """Sums of the frames of a capture, without their hot pixels, which would be spread along the path."""

    def __init__(self, capture: Capture) -> None:
        self.capture = capture
        some = capture.frames[:DIM_FRAMES_FOR_POWER]
        self._hot = HotPixels.of(np.asarray(frame, np.float32) for frame in some)

    def add(self, path: np.ndarray, groups: Sequence[range]) -> Capture:
        """Return a capture of the sums of groups of frames, each moved back to the middle frame by whole pixels.

        Photoelectrons stay integers, but for pixels that are replaced. Pixels that a frame of a group does not hold are cut off from all.
        Raises InputError if hardly any are left, and if the sums exceed the memory.
        """
        capture, shape = self.capture, self.capture.frames[0].shape
        needed = 4.0 * len(groups) * capture.frames[0].size
        if needed > memory_bytes():
            raise InputError("frames", f"at most {memory_bytes():.2g} bytes", f"{needed:.2g}", "use fewer frames")
        moves = [np.rint(path[group] - path[group[len(group) // 2]]).astype(int) for group in groups]
        least, most = (np.array([function(one, 0) for one in moves]) for function in (np.min, np.max))
        before, after = -least.min(0).clip(max=0), most.max(0).clip(min=0)
        if any(side < start + end + 2 for side, start, end in zip(shape, before, after, strict=True)):
            raise InputError("frames", "an object that stays in the frame", "a longer way", "take shorter groups")
        kept = tuple(slice(start, side - end) for side, start, end in zip(shape, before, after, strict=True))
        sums = [
            sum(_part(self._clean(number), kept, move) for number, move in zip(group, ways, strict=True))
            for group, ways in zip(groups, moves, strict=True)
        ]
        measured = capture.measured
        if measured is not None:
            alike = {tuple(move) for ways in moves for move in ways}
            measured = np.logical_and.reduce([_part(measured, kept, move) for move in alike])
        written, size = capture.file_metadata, len(groups[0])
        if written.exposure_s is not None:
            written = replace(written, exposure_s=size * written.exposure_s)
        return replace(capture, frames=sums, names=(), headers=(), measured=measured, file_metadata=written)

    def _clean(self, number: int) -> np.ndarray:
        """Return a frame as float32, because sums of integers would overflow, without hot pixels."""
        return self._hot.replaced_in(np.asarray(self.capture.frames[number], np.float32))


def _part(frame: np.ndarray, kept: tuple[slice, ...], move: Sequence[int]) -> np.ndarray:
    return frame[tuple(slice(one.start + way, one.stop + way) for one, way in zip(kept, move, strict=True))]
