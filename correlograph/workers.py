"""Parallel tasks: processes on this machine, which listen on no port, or the workers of a Dask cluster."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib.util import find_spec
from multiprocessing import active_children, connection, get_context, parent_process
from typing import Any

from correlograph.errors import InputError
from correlograph.ranges import WORKERS


class WorkerDeath:
    """Outcome of a task whose worker process died, for example for lack of memory."""


def check_workers(workers: int | None, scheduler: str | None) -> int:
    """Return the number of workers: the requested one, or one per core.

    Raises InputError for workers and a scheduler together.
    """
    if scheduler is not None and workers is not None:
        raise InputError("--scheduler", "no --workers together with it", f"--workers {workers}", "remove one of them")
    return workers if workers is not None else min(os.cpu_count() or 1, int(WORKERS.most))


def check_scheduler(address: str) -> None:
    """Refuse a scheduler that does not answer. A subprocess checks it, because a silent scheduler blocks its client."""
    asks = "import sys; from distributed import Client; Client(sys.argv[1], timeout=10, set_as_default=False).close(timeout=5)"
    try:
        done = subprocess.run([sys.executable, "-c", asks, address], capture_output=True, text=True, check=False, timeout=30)
        found = (done.stderr.strip().splitlines() or [""])[-1][:120] if done.returncode else None
    except subprocess.TimeoutExpired:
        found = "silence for 30 s"
    if found is not None and find_spec("distributed") is None:
        raise InputError("--scheduler", "the package dask", "none", "pip install 'correlograph[cluster]'")
    if found is not None:
        raise InputError(
            "--scheduler", "a Dask scheduler that answers", f"{address} ({found})", "start one with 'dask scheduler'"
        )


def run_tasks(
    task: Callable[[Any], Any], items: Sequence[Any], workers: int, scheduler: str | None = None
) -> Iterator[tuple[Any, Any]]:
    """Run a task on every item in parallel; yield (item, outcome) in the order of completion.

    The outcome is `WorkerDeath` if a worker died repeatedly on the item. Exceptions of the task are raised.

    Args:
        task: a picklable function of one item.
        workers: number of processes on this machine.
        scheduler: address of a running Dask scheduler to use instead.
    """
    if not items:
        return iter(())
    if scheduler is None:
        return _run_locally(task, items, workers)
    return _run_on_cluster(task, items, scheduler)


def _run_locally(task: Callable[[Any], Any], items: Sequence[Any], workers: int) -> Iterator[tuple[Any, Any]]:
    """Run tasks in a process pool. If a worker dies, the unfinished items run again in a new pool, and after a second death
    one by one.
    """
    remaining = list(items)
    for attempt_workers in (workers, workers):
        for item, outcome in _run_pool(task, remaining, attempt_workers):
            remaining.remove(item)
            yield item, outcome
        if not remaining:
            return
    for item in remaining:
        yield from list(_run_pool(task, [item], 1)) or [(item, WorkerDeath())]


def _run_pool(task: Callable[[Any], Any], items: Sequence[Any], workers: int) -> Iterator[tuple[Any, Any]]:
    """Yield the outcomes of one process pool, up to the death of a worker."""
    others = active_children()
    pool = ProcessPoolExecutor(min(workers, len(items)), mp_context=get_context("spawn"), initializer=_prepare_worker)
    try:
        with _interruptions_blocked():  # the processes start here and inherit it
            futures = {pool.submit(task, item): item for item in items}
        for future in as_completed(futures):
            try:
                yield futures[future], future.result()
            except BrokenProcessPool:
                return
    except BrokenProcessPool:
        return
    except BaseException:
        for process in set(active_children()).difference(others):
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _interruptions_blocked() -> Iterator[None]:
    """Block SIGINT in this thread, where the system can, so that Ctrl-C does not end processes while they import modules."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _prepare_worker() -> None:
    """Use one thread, leave interruptions to the parent process, and end with it."""
    os.environ["OMP_NUM_THREADS"] = "1"  # numpy and torch read it when they load, after this function
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is None:
        return

    def end_with_parent() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def _run_on_cluster(task: Callable[[Any], Any], items: Sequence[Any], scheduler: str) -> Iterator[tuple[Any, Any]]:
    from distributed import Client, KilledWorker
    from distributed import as_completed as completed

    with Client(scheduler, timeout=20) as client:
        futures = client.map(task, items, pure=False, retries=2)
        item_of = {future.key: item for future, item in zip(futures, items, strict=True)}
        for future in completed(futures):
            try:
                yield item_of[future.key], future.result()
            except KilledWorker:
                yield item_of[future.key], WorkerDeath()


def map_on_cluster(task: Callable[[Any, Any], Any], shared: Any, items: Sequence[Any], scheduler: str) -> Iterator[Any]:
    """Run task(shared, item) on the workers of a Dask cluster; yield the outcomes in the order of the items.

    Args:
        task: a picklable function; its exceptions are raised.
        shared: a picklable object, which is sent to each worker once.
        scheduler: address of a running Dask scheduler.

    Raises InputError if workers died repeatedly on an item.
    """
    from distributed import Client, KilledWorker

    with Client(scheduler, timeout=20) as client:
        sent = client.scatter(shared, hash=False)
        futures = deque(client.submit(task, sent, item, pure=False, retries=2) for item in items)
        while futures:
            try:
                yield futures.popleft().result()
            except KilledWorker:
                raise InputError(
                    "--scheduler", "workers with enough memory", "workers that died", "give each worker more memory"
                ) from None


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Run torch on one thread. Several wait for one another in busy loops, which costs time when other programs use the
    cores, and round differently for each number of threads.
    """
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
