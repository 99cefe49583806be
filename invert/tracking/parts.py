"""Work on spectra of many frames on all cores, in parts that fit into their caches. Sums do not depend on the number of cores."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
import torch

PART_BYTES = 2**22
"""Approximate memory of the spectra of a part."""

Item = TypeVar("Item")
Found = TypeVar("Found")


def on_all_cores(task: Callable[[Item], Found], items: Iterable[Item]) -> list[Found]:
    """Return the results of a task for each item, in their order."""
    if torch.get_num_threads() == 1:
        return [task(one) for one in items]
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        return list(pool.map(task, items))


def sum_over_rows(task: Callable[[slice], np.ndarray], spectra: np.ndarray) -> np.ndarray:
    """Return the sum of the results of a task for parts of the rows of spectra (n, R, C)."""
    return sum(on_all_cores(task, parts_of_rows(spectra)), np.zeros(()))


def parts_of_rows(spectra: np.ndarray, multiple: int = 1) -> list[slice]:
    """Return parts of the rows of spectra (n, R, C), each of a multiple of a number of rows."""
    count, rows, columns = spectra.shape
    size = multiple * max(1, PART_BYTES // (multiple * count * columns * spectra.itemsize))
    return [slice(first, first + size) for first in range(0, rows, size)]
