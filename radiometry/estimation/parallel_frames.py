"""Addition of many frames to an estimate on all cores. The sums do not depend on the number of cores."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import torch

from radiometry.estimation.frame_sums import FrameSums
from radiometry.estimation.saved_sums import SavedSums
from radiometry.estimation.third_moment import MAX_FRAMES
from radiometry.estimation.whole_frames import AutocorrelationEstimator

PART_FRAMES = MAX_FRAMES
"""Number of frames that one thread adds up before their sums are added to those of the capture."""

MAX_THREADS = 8
"""Maximum number of threads; each needs the memory of about ten frames."""


def add_frames(
    estimator: AutocorrelationEstimator,
    frames: Sequence[np.ndarray],
    advance: Callable[[int], object] = lambda _: None,
    saved: SavedSums | None = None,
    threads: int | None = None,
) -> None:
    """Add frames to an estimator that has none.

    Frames are added in parts of `PART_FRAMES`, and these in their order, so that the sums are the same for any number of threads.

    Args:
        advance: called with a number of frames when these have been added.
        saved: sums of an earlier run, from which this one continues, and which it replaces.
        threads: number of threads; as many as torch uses by default.
    """
    own_threads = torch.get_num_threads()

    def add_part(numbers: range) -> FrameSums:
        part = FrameSums()
        for number in numbers:
            part.add(estimator.sums_of(frames[number], number))
            advance(1)
        return part

    def add_first_part() -> None:
        estimator.start(frames[0])
        advance(1)
        estimator.sums.add(add_part(range(1, min(PART_FRAMES, len(frames)))))

    threads = threads or min(own_threads, MAX_THREADS)
    pool = ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,))
    try:
        pool.submit(add_first_part).result()
        if saved is not None:
            pool.submit(saved.continue_with, estimator, frames).result()
            advance(estimator.frames - min(PART_FRAMES, len(frames)))
        waiting: deque[Future[FrameSums]] = deque()

        def add_oldest_part() -> None:
            estimator.sums.add(waiting.popleft().result())
            if saved is not None:
                saved.write(estimator, is_complete=estimator.frames == len(frames))

        for begin in range(estimator.frames, len(frames), PART_FRAMES):
            waiting.append(pool.submit(add_part, range(begin, min(begin + PART_FRAMES, len(frames)))))
            if len(waiting) > threads:
                add_oldest_part()
        while waiting:
            add_oldest_part()
    finally:
        pool.shutdown(cancel_futures=True)
        torch.set_num_threads(own_threads)
