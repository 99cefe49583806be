"""Shards over Dask workers, with progress: processes on this machine, or a cluster elsewhere."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from tqdm import tqdm

from data_gen.store import shard_size
from data_gen.targets import BLOCK, draw_block
from data_gen.work import Recipe, make_shard, measure
from radiometry.errors import InputError


def check_scheduler(address: str) -> None:
    """Refuse a scheduler that does not answer: asked by another process, since one that accepts and is silent holds its client
    for ever."""
    asks = "import sys; from distributed import Client; Client(sys.argv[1], timeout=10, set_as_default=False).close(timeout=5)"
    try:
        done = subprocess.run([sys.executable, "-c", asks, address], capture_output=True, text=True, check=False, timeout=30)
        found = (done.stderr.strip().splitlines() or [""])[-1][:120] if done.returncode else None
    except subprocess.TimeoutExpired:
        found = "silence for 30 s"
    if found is not None:
        raise InputError("--scheduler", "a Dask scheduler that answers", f"{address} ({found})",
                         "start one with 'dask scheduler'")


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator:
    """A Dask client of its own local cluster, or of a running scheduler."""
    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        with Client(scheduler, timeout=20) as client:
            yield client
        return
    with (_environment_kept(),
          dask.config.set({"distributed.worker.memory.terminate": False, "distributed.logging.distributed": "error"}),
          LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster,
          Client(cluster) as client):
        yield client


@contextmanager
def _environment_kept() -> Iterator[None]:
    """Dask sets OMP_NUM_THREADS=1 for its workers in this process, too: later children would inherit it."""
    before = dict(os.environ)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def make_shards(address: str, recipe: Recipe, shards: list[int], workers: int, scheduler: str | None) -> int:
    """Make shards in parallel; returns the number of samples made.

    A shard whose worker dies is given to another. Whatever stops the work, finished shards stay.
    """
    from distributed import KilledWorker, as_completed

    if not shards:
        return 0
    made = 0
    size = shard_size(recipe.measurement)
    total = sum(min(size, recipe.count - shard * size) for shard in shards)
    with _client(workers, scheduler) as client, tqdm(total=total, unit="sample", disable=None) as bar:
        futures = client.map(partial(make_shard, address, recipe), shards, pure=False, retries=2)
        for future in as_completed(futures):
            try:
                done = future.result()
            except KilledWorker:
                raise InputError("worker", "workers that survive", "repeated deaths on one shard",
                                 "give them more memory, then run the same command again") from None
            made += done
            bar.update(done)
    return made


def predicted_seconds(recipe: Recipe, workers: int) -> float:
    """Time of all samples, timed on one block of each kind of target."""
    begin = time.perf_counter()
    for block in range(len(recipe.source.kinds)):
        targets, _ = draw_block(recipe.source, recipe.seed, block)
        if recipe.measurement != "none":
            measure(recipe, block, targets)
    each = (time.perf_counter() - begin) / len(recipe.source.kinds) / BLOCK
    return recipe.count * each / workers
