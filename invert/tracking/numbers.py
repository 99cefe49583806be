"""Numbers of frames by the names of their files, which tell those that are missing."""

from __future__ import annotations

import re

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import Capture

MAX_DIGITS = 18
"""Digits of a number that fits into 64 bits."""


def frame_numbers(capture: Capture) -> np.ndarray:
    """Return the number of each frame from the first one, (frames,), in units of the smallest difference.

    A number in the names of files that rises by multiples of its least difference tells which are missing, unless another such number
    disagrees. Otherwise frames are counted. Raises InputError if the only number that differs falls and rises: names in the order of text.
    """
    counted = np.arange(len(capture.frames))
    parts = [re.split("([0-9]+)", name) for name in capture.names]
    if len({*capture.names}) < max(len(counted), 2) or any(one[::2] != parts[0][::2] for one in parts):
        return counted
    columns = [one for one in zip(*(name[1::2] for name in parts), strict=True) if len(set(one)) > 1]
    if any(len(digits) > MAX_DIGITS for one in columns for digits in one):
        return counted
    varying = [np.diff(np.array(one, np.int64)) for one in columns]
    if len(varying) == 1 and varying[0].min() < 0 < varying[0].max():
        place = int(np.argmax(varying[0] < 0))
        found = f"{capture.names[place + 1]} after {capture.names[place]}"
        raise InputError(
            "frames", "files in the order of their numbers", found, "name their folder, sort them by number, or rename them"
        )
    rising = {tuple(steps // steps.min()) for steps in varying if steps.min() > 0 and not (steps % steps.min()).any()}
    return counted if len(rising) != 1 else np.concatenate([[0], np.cumsum(rising.pop())])


def missing_frames(numbers: np.ndarray) -> list[str]:
    """Return a warning if numbers of frames (frames,) leave some out."""
    missing = int(numbers[-1]) + 1 - len(numbers)
    if not missing:
        return []
    first = int(np.argmax(np.diff(numbers) > 1)) + 1
    return [
        f"by their numbers, {missing} of {int(numbers[-1]) + 1} frames are missing, the first after {first} frames; times and steps "
        "count them"
    ]
