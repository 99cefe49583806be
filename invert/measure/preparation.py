"""Frames as they come from a lab, prepared for an estimate: empty frames left out, corrections applied, the camera's offset removed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from correlograph.files.capture import Capture
from correlograph.files.captured_frames import check_copies
from correlograph.files.corrections import Corrections
from correlograph.files.file_frames import FileFrames
from radiometry.autocorrelation import automatic_patch_size
from radiometry.estimation.camera_offset import camera_offset, offset_from_speckle
from radiometry.estimation.illumination import is_uneven
from radiometry.estimation.photon_transfer import photon_transfer

MAX_EMPTY_STRUCTURE, MAX_UNCLEAR_STRUCTURE = 1e-3, 0.02
"""Variance beyond pixel noise, in units of the median over the frames, below which a frame counts as one without light; and below which it
does if this variance is not clear."""

STRUCTURE_SIGMA = 10.0
"""Standard errors by which that median must exceed zero, for dim frames to be judged at all, and a variance, to be clear."""

MIN_LIT_PIXELS = 100
"""Number of pixels of all frames together that differ from the rest, below which frames count as dark: few photons have no statistics."""

OFFSET_FRAMES = 4
"""Number of frames from which an offset is estimated."""


def prepare(capture: Capture, corrections: Corrections) -> tuple[Capture, list[str]]:
    """Return the capture with corrected frames, and notes on what was found and done.

    An offset is estimated from the noise of the frames if there is no dark frame, and if it matters: for a flat-field frame, and for an
    uneven illumination, which are ratios of light. Frames with hardly a lit pixel are returned as dark. Raises InputError for unsuitable
    correction files, and for copies of frames in memory.
    """
    if not isinstance(capture.frames, FileFrames):
        check_copies(capture.frames)
    capture, notes = leave_out_empty(capture)
    if 0 < (lit := count_lit(capture)) < MIN_LIT_PIXELS:
        notes.append(f"only {lit} of all pixels are lit, which says nothing about an object; expose longer")
        return replace(capture, frames=[np.zeros_like(capture.frames[0])] * len(capture.frames)), notes
    if corrections.dark is not None:
        return corrections.apply(capture), notes
    first = [np.asarray(frame) for frame in capture.frames[:OFFSET_FRAMES]]
    if corrections.flat is not None or _is_uneven(capture, first):
        # Read noise lowers the offset from the noise, but not the one from the speckle.
        found = [one for one in (camera_offset(first), offset_from_speckle(first)) if one is not None]
        if found:
            offset = max(found)
            notes.append(
                f"an offset of about {offset:.3g} counts, found from noise and speckle of the frames, was subtracted; a dark frame "
                "gives it exactly"
            )
            return replace(corrections, dark=np.full(first[0].shape, offset, np.float32)).apply(capture), notes
        if corrections.flat is not None:
            notes.append("there is no dark frame; an offset of the camera would distort flat-field frame and image")
    return corrections.apply(capture), notes


def leave_out_empty(capture: Capture) -> tuple[Capture, list[str]]:
    """Return the capture without empty frames (`find_empty`), and a note that names them."""
    frames, left_out = capture.frames, find_empty(capture)
    if not left_out:
        return capture, []
    kept = [number for number in range(len(frames)) if number not in left_out]
    chosen = {
        "frames": [frames[number] for number in kept],
        "names": tuple(capture.names[number] for number in kept) if len(capture.names) == len(frames) else capture.names[:1],
        "headers": tuple(capture.headers[number] for number in kept) if capture.headers else (),
    }
    names = ", ".join(left_out.values())
    return replace(capture, **chosen), [f"{names} left out: without light, as a dark frame is (use --dark for it)"]


def count_lit(capture: Capture) -> int:
    """Return the number of pixels of all frames that differ from the median of their frame, counted until there are enough."""
    total = 0
    for frame in capture.frames:
        pixels = np.asarray(frame)
        total += int(np.count_nonzero(pixels != np.median(pixels)))
        if total >= MIN_LIT_PIXELS:
            break
    return total


def find_empty(capture: Capture) -> dict[int, str]:
    """Return numbers and names of the frames that hold no light although others do, such as a dark frame among them; none of a capture that
    is not kept in memory."""
    frames = capture.frames
    if isinstance(frames, FileFrames) or len(frames) < 2:
        return {}
    structure = np.array([_structure(frame) for frame in frames])
    typical = float(np.median(structure[:, 0]))
    if typical <= STRUCTURE_SIGMA * float(np.median(structure[:, 1])):
        return {}
    limit = np.clip(STRUCTURE_SIGMA * structure[:, 1], MAX_EMPTY_STRUCTURE * typical, MAX_UNCLEAR_STRUCTURE * typical)
    empty = np.flatnonzero(~(structure[:, 0] > limit)).tolist()
    named = len(capture.names) == len(frames)
    return {number: capture.names[number] if named else f"frame {number}" for number in empty}


def mean_frame(capture: Capture) -> Capture:
    """Return a capture of one frame, the mean of all."""
    total = np.zeros(capture.frames[0].shape)
    for frame in capture.frames:
        total += frame
    mean = (total / len(capture.frames)).astype(np.float32)
    # The mean of n frames of gain g has the noise of a camera with g / n frame units per electron.
    gain_e = capture.file_metadata.gain_e
    written = replace(capture.file_metadata, gain_e=gain_e and gain_e * len(capture.frames))
    return replace(capture, frames=[mean], names=capture.names[:1], headers=capture.headers[:1], file_metadata=written)


def _structure(frame: np.ndarray) -> tuple[float, float]:
    """Return the variance of a frame in excess of the noise of its pixels, and its standard error."""
    image = torch.as_tensor(np.ascontiguousarray(frame, np.float32))
    total, noise = float(image.double().var()), photon_transfer(image).variance
    return total - noise, (2.0 / image.numel()) ** 0.5 * (total + 2.0 * noise)


def _is_uneven(capture: Capture, frames: Sequence[np.ndarray]) -> bool:
    shape = (frames[0].shape[0], frames[0].shape[1])
    size = automatic_patch_size(shape, capture.camera.lag_geometry)
    return is_uneven(torch.as_tensor(np.asarray(frames[0], np.float32)), (size, size))
