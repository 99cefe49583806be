"""Unit of work: targets and measurements of one shard, equal on every worker."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
import zarr

from correlograph.errors import InputError
from correlograph.files.store import write_part
from data_gen.measurement import SceneMeasurement, draw_noise_levels, model_measurement
from data_gen.store import dataset_schema, shard_size
from data_gen.targets import BLOCK, TargetSource, draw_block


@dataclass(frozen=True)
class Recipe:
    """Everything that the content of a shard depends on.

    Attributes:
        measurement: `none`, `noise-model` or `render`.
        scene: scene file of rendered measurements, or of the levels and H of the noise model; None for ranges.
        floor_over_peak, dof: ranges of the noise model without a scene.
    """

    source: TargetSource
    count: int
    seed: int
    measurement: str
    scene: str | None
    floor_over_peak: tuple[float, float]
    dof: tuple[float, float]


def make_shard(address: str, recipe: Recipe, shard: int) -> int:
    """Compute and write one shard; return its number of samples."""
    torch.set_num_threads(1)  # shards run in parallel processes
    size = shard_size(recipe.measurement)
    start, stop = shard * size, min((shard + 1) * size, recipe.count)
    parts = []
    for block in range(start // BLOCK, -(-stop // BLOCK)):
        targets, validation = draw_block(recipe.source, recipe.seed, block)
        targets = targets[: stop - block * BLOCK]
        part = {"albedo": targets, "split": np.full(len(targets), validation, np.uint8)}
        if recipe.measurement != "none":
            part |= measure(recipe, block, targets)
        parts.append(part)
    write_part(
        zarr.open_group(address, mode="r+"),
        dataset_schema(recipe.measurement, recipe.source.side - 1),
        shard,
        {name: np.concatenate([part[name] for part in parts]) for name in parts[0]},
    )
    return stop - start


def measure(recipe: Recipe, block: int, targets: np.ndarray) -> dict[str, np.ndarray]:
    """Return the measurements of a block's targets, uint8 (n, 64, 64)."""
    albedo = targets.astype(np.float32) / np.float32(255.0)
    streams = np.random.SeedSequence([recipe.seed, block, 1]).spawn(2)
    rng = torch.Generator().manual_seed(int(streams[1].generate_state(1)[0]))
    if recipe.scene is None:
        floor, dof = draw_noise_levels(len(targets), recipe.floor_over_peak, recipe.dof, np.random.default_rng(streams[0]))
        lags = model_measurement(torch.from_numpy(albedo), torch.from_numpy(floor), torch.from_numpy(dof), rng).numpy()
    else:
        place = _place(recipe.scene, recipe.source.side - 1)
        levels = [place.noise_level(one) for one in albedo]
        floor = np.array([level / peak for level, peak in levels], np.float32)
        dof = np.full(len(targets), place.dof, np.float32)
        if recipe.measurement == "render":
            seeds = streams[0].generate_state(len(targets))
            lags = np.stack([place.render(one, int(seed)) for one, seed in zip(albedo, seeds, strict=True)])
        else:
            lags = place.model(torch.from_numpy(albedo), torch.from_numpy(floor), rng).numpy()
    with np.errstate(over="ignore"):
        stored = lags.astype(np.float16)
    if not np.isfinite(stored).all():
        raise InputError(
            "measurement",
            "estimates up to 65504 times (r*r)(0)",
            f"floors up to {floor.max():.3g}",
            "lower --floor-over-peak or raise --dof; of a scene, the light",
        )
    return {"autocorrelation": stored, "floor_over_peak": floor, "dof": dof}


@lru_cache(maxsize=1)
def _place(scene: str, lags: int) -> SceneMeasurement:
    return SceneMeasurement(scene, lags)
