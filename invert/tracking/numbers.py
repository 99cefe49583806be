"""Numbers and order of frames by the names of their files, which tell those that are missing."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

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
    if len({*capture.names}) < max(len(counted), 2) or not _differ_by_numbers(capture.names):
        return counted
    columns = _varying_numbers(capture.names)
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


def doubts_of_order(names: Sequence[str]) -> list[str]:
    """Return a warning if the order of files by name may not be that of time: names that differ in more than numbers, such as negative
    ones or `f (1)` after `f`; decimals of different length; and a number that falls from file to file."""
    if len({*names}) < max(len(names), 2):
        return []
    if _differ_by_numbers(names):
        columns = _varying_numbers(names)
        falls = len(columns) == 1 and all(int(one) > int(other) for one, other in pairwise(columns[0]))
        if not falls and not _have_decimals(names):
            return []
    return [
        f"the names of the files do not tell their order for certain: {names[0]}, {names[1]}, ..., {names[-1]}; if this is not that of "
        "time, steps and velocities are wrong: rename them, with numbers that rise"
    ]


def _differ_by_numbers(names: Sequence[str]) -> bool:
    """Return whether names differ in nothing but whole numbers."""
    return len({tuple(re.split("[0-9]+", name)) for name in names}) == 1


def _varying_numbers(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the digits of each number that is not the same in all names, which differ in nothing else."""
    return [one for one in zip(*(re.findall("[0-9]+", name) for name in names), strict=True) if len(set(one)) > 1]


def _have_decimals(names: Sequence[str]) -> bool:
    """Return whether digits after a point differ in number, so that 0.5 could be before or after 0.25."""
    found = [[len(one) for one in re.findall(r"(?<=[0-9]\.)[0-9]+", name)] for name in names]
    return any(one != found[0] for one in found)


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
