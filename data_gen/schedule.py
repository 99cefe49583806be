"""Shards on parallel workers, with progress."""

from __future__ import annotations

import time
from functools import partial

from tqdm import tqdm

from correlograph.errors import InputError
from correlograph.workers import WorkerDeath, run_tasks
from data_gen.store import shard_size
from data_gen.targets import BLOCK, draw_block
from data_gen.work import Recipe, make_shard, measure


def make_shards(address: str, recipe: Recipe, shards: list[int], workers: int, scheduler: str | None) -> int:
    """Make shards in parallel; return the number of samples.

    The shard of a worker that dies is given to another. Finished shards remain after any interruption.
    """
    made = 0
    size = shard_size(recipe.measurement)
    total = sum(min(size, recipe.count - shard * size) for shard in shards)
    with tqdm(total=total, unit="sample", disable=None) as bar:
        for _, done in run_tasks(partial(make_shard, address, recipe), shards, workers, scheduler):
            if isinstance(done, WorkerDeath):
                raise InputError(
                    "worker",
                    "workers that survive",
                    "repeated deaths on one shard",
                    "give them more memory, then run the same command again",
                )
            made += done
            bar.update(done)
    return made


def predicted_seconds(recipe: Recipe, workers: int) -> float:
    """Return the predicted time in seconds to generate all samples, from one timed block of each kind of target."""
    begin = time.perf_counter()
    for block in range(len(recipe.source.kinds)):
        targets, _ = draw_block(recipe.source, recipe.seed, block)
        if recipe.measurement != "none":
            measure(recipe, block, targets)
    each = (time.perf_counter() - begin) / len(recipe.source.kinds) / BLOCK
    return recipe.count * each / workers
