"""Addition of many frames to an estimate, on all cores or on a Dask cluster. The sums do not depend on the number of workers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from copy import copy

import numpy as np
import torch

from correlograph.files.file_frames import FileFrames, FrameCheck
from correlograph.workers import map_on_cluster
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator
from radiometry.estimation.frame_sums import FrameSums
from radiometry.estimation.saved_sums import SavedSums
from radiometry.estimation.third_moment import MAX_FRAMES

PART_FRAMES = MAX_FRAMES
"""Number of frames that one thread adds up."""

BLOCK_FRAMES = 32 * PART_FRAMES
"""Number of frames whose parts are added up before they are added to the sums of the capture; a task of a cluster."""

MAX_THREADS = 8
"""Maximum number of threads; each needs the memory of about ten frames."""


def add_frames(
    estimator: AutocorrelationEstimator,
    frames: Sequence[np.ndarray],
    advance: Callable[[int], object] = lambda _: None,
    saved: SavedSums | None = None,
    threads: int | None = None,
    scheduler: str | None = None,
) -> None:
    """Add frames to an estimator that has none.

    Frames are added in parts of `PART_FRAMES`, these in blocks of `BLOCK_FRAMES`, and all in their order, so that the sums are the
    same for any number of threads or workers.

    Args:
        advance: progress callback, called with the number of frames added since its last call.
        saved: sums of an earlier run, from which this one continues, and which it replaces.
        threads: number of threads; as many as torch uses by default.
        scheduler: address of a running Dask scheduler, whose workers read and add frames that lie in files.
    """
    own_threads = torch.get_num_threads()
    threads = threads or min(own_threads, MAX_THREADS)
    pool = ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,))
    try:
        pool.submit(_add_first_part, estimator, frames).result()
        if saved is not None:
            pool.submit(saved.continue_with, estimator, frames).result()
        advance(estimator.frames)
        blocks = _ranges(range(estimator.frames, len(frames)), BLOCK_FRAMES)
        if scheduler is not None and isinstance(frames, FileFrames):
            sums_of_blocks = _sums_on_cluster(estimator, frames, blocks, scheduler, advance)
        else:
            sums_of_blocks = _sums_on_threads(estimator, frames, blocks, pool, threads, advance)
        for sums in sums_of_blocks:
            estimator.sums.add(sums)
            if saved is not None:
                saved.write(estimator, is_complete=estimator.frames == len(frames))
    finally:
        pool.shutdown(cancel_futures=True)
        torch.set_num_threads(own_threads)


def _add_first_part(estimator: AutocorrelationEstimator, frames: Sequence[np.ndarray]) -> None:
    estimator.start(frames[0])
    estimator.sums.add(_sums_of_part(estimator, frames, range(1, min(PART_FRAMES, len(frames)))))


def _ranges(numbers: range, size: int) -> list[range]:
    """Divide numbers into ranges of a size; the last may be shorter."""
    return [range(begin, min(begin + size, numbers.stop)) for begin in range(numbers.start, numbers.stop, size)]


def _sums_of_part(
    estimator: AutocorrelationEstimator,
    frames: Sequence[np.ndarray],
    numbers: range,
    advance: Callable[[int], object] = lambda _: None,
) -> FrameSums:
    part = FrameSums()
    for number in numbers:
        part.add(estimator.sums_of(frames[number], number))
        advance(1)
    return part


def _sums_on_threads(
    estimator: AutocorrelationEstimator,
    frames: Sequence[np.ndarray],
    blocks: list[range],
    pool: ThreadPoolExecutor,
    threads: int,
    advance: Callable[[int], object],
) -> Iterator[FrameSums]:
    """Yield the sums of each block; one part more than threads is under way, also across the ends of blocks."""
    parts = [part for block in blocks for part in _ranges(block, PART_FRAMES)]
    under_way: deque[Future[FrameSums]] = deque()
    begun = iter(parts)

    def begin_next_part() -> None:
        if (numbers := next(begun, None)) is not None:
            under_way.append(pool.submit(_sums_of_part, estimator, frames, numbers, advance))

    for _ in range(threads + 1):
        begin_next_part()
    for block in blocks:
        sums = FrameSums()
        while sums.frames < len(block):
            sums.add(under_way.popleft().result())
            begin_next_part()
        yield sums


def _sums_on_cluster(
    estimator: AutocorrelationEstimator,
    frames: FileFrames,
    blocks: list[range],
    scheduler: str,
    advance: Callable[[int], object],
) -> Iterator[FrameSums]:
    """Yield the sums of each block, which the workers of a cluster read from the files under the same names."""
    bare = copy(estimator)
    bare.sums = FrameSums()
    for sums, check in map_on_cluster(_sums_of_block, (bare, frames), blocks, scheduler):
        frames.check.merge(check)
        advance(sums.frames)
        yield sums


def _sums_of_block(shared: tuple[AutocorrelationEstimator, FileFrames], numbers: range) -> tuple[FrameSums, FrameCheck]:
    """Return the sums of a block, computed in a worker of a cluster, and the state of the check of its frames."""
    estimator, frames = shared
    torch.set_num_threads(1)  # as in the threads, so that rounding is the same
    sums = FrameSums()
    for part in _ranges(numbers, PART_FRAMES):
        sums.add(_sums_of_part(estimator, frames, part))
    return sums, frames.check
