"""Dask workers: processes on this machine, or a cluster."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from correlograph.errors import InputError
from correlograph.ranges import WORKERS


def check_workers(workers: int | None, scheduler: str | None) -> int:
    """Return the number of workers: the requested one, or one per core. Raises InputError for workers and a scheduler
    together."""
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
    if found is not None:
        raise InputError(
            "--scheduler", "a Dask scheduler that answers", f"{address} ({found})", "start one with 'dask scheduler'"
        )


@contextmanager
def cluster_client(workers: int, scheduler: str | None) -> Iterator:
    """Yield a Dask client of a local cluster, or of a running scheduler."""
    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        with Client(scheduler, timeout=20) as client:
            yield client
        return
    with (
        _environment_kept(),
        dask.config.set({"distributed.worker.memory.terminate": False, "distributed.logging.distributed": "error"}),
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster,
        Client(cluster) as client,
    ):
        yield client


@contextmanager
def _environment_kept() -> Iterator[None]:
    """Restore the environment: Dask sets OMP_NUM_THREADS=1 in this process, and later subprocesses would inherit it."""
    before = dict(os.environ)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
