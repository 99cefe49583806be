"""Datasets on disk: a sharded Zarr v3 group with its manifest, complete shard by shard.

Arrays: `albedo` uint8 (n, 64, 64), 255 for albedo 1; `split` uint8 (n,), 0 training, 1 validation; and,
unless the dataset holds targets only, `autocorrelation` float16 (n, 127, 127) in units of (r*r)(0), zero lag at [63, 63],
`floor_over_peak` and `dof` float32 (n,). `complete` holds 1 for each shard that is whole. The manifest is the
group's attributes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import zarr
from zarr.errors import GroupNotFoundError

from data_gen.targets import BLOCK
from radiometry.autocorrelation import LAG_SIDE, OBJECT_SIDE
from radiometry.errors import InputError


def shard_size(measurement: str) -> int:
    """Samples of one shard (one file an array, one unit of work): a minute of rendering, or seconds of anything else."""
    return BLOCK if measurement == "render" else 32 * BLOCK


ARRAYS = ("albedo", "split", "autocorrelation", "floor_over_peak", "dof", "complete")

PAIR_BYTES = OBJECT_SIDE * OBJECT_SIDE // 16 + 2 * LAG_SIDE * LAG_SIDE + 8
"""Bytes of a sample with its measurement, targets compressed about sixteenfold."""


def create(address: str, manifest: dict[str, Any], count: int, measurement: str) -> zarr.Group:
    """Open a dataset to go on with, or make an empty one; InputError where it was made with other arguments."""
    try:
        group = zarr.open_group(address, mode="r+")
    except (GroupNotFoundError, FileNotFoundError):
        return _empty(address, manifest, count, measurement)
    except (OSError, ImportError) as error:  # the latter for addresses whose fsspec package is not installed
        raise InputError("dataset", "a store that can be written to", f"{address} ({error})", "choose another") from None
    found = group.attrs.asdict()
    if not found and set(group.keys()) <= set(ARRAYS):
        return _empty(address, manifest, count, measurement)  # stopped while it was being made
    if not found:
        raise InputError("dataset", "a dataset of this program or nothing", f"another Zarr group at {address}",
                         "choose another address")
    for key, value in manifest.items():
        if found.get(key) != value:
            raise InputError("dataset", f"the {key} that {address} was begun with", _difference(found.get(key), value),
                             "ask again with the same, or choose another address")
    return group


def _empty(address: str, manifest: dict[str, Any], count: int, measurement: str) -> zarr.Group:
    size = shard_size(measurement)
    try:
        group = zarr.create_group(address, overwrite=True)
        arrays = [("albedo", (OBJECT_SIDE, OBJECT_SIDE), "uint8", "auto"), ("split", (), "uint8", "auto")]
        if measurement != "none":
            arrays += [("autocorrelation", (LAG_SIDE, LAG_SIDE), "float16", None), ("floor_over_peak", (), "float32", "auto"),
                       ("dof", (), "float32", "auto")]
        for name, shape, kind, compressors in arrays:
            group.create_array(name, shape=(count, *shape), dtype=kind, chunks=(BLOCK, *shape), shards=(size, *shape),
                               compressors=compressors)
        group.create_array("complete", shape=(-(-count // size),), dtype="uint8", chunks=(1,), compressors=None)
        group.attrs.update(manifest)  # last: without it a store counts as not begun
    except (OSError, ValueError) as error:
        raise InputError("dataset", "an address that can be written to", f"{address} ({error})",
                         "free some space or choose another") from None
    return group


def _difference(found: Any, wanted: Any) -> str:
    """What differs between two manifest entries."""
    if isinstance(found, dict) and isinstance(wanted, dict):
        keys = [key for key in {**found, **wanted} if found.get(key) != wanted.get(key)]
        return ", ".join(f"{key} {found.get(key)!r:.60} there and {wanted.get(key)!r:.60} here" for key in keys)
    return "another" if found is not None else "none"


def missing_shards(group: zarr.Group) -> list[int]:
    """Shards that are not whole yet."""
    return np.flatnonzero(np.asarray(group["complete"]) == 0).tolist()


def write_shard(group: zarr.Group, shard: int, start: int, arrays: dict[str, np.ndarray]) -> None:
    """Write one shard's arrays, the first sample at `start`, and, when they are in place, mark it complete."""
    for name, values in arrays.items():
        group[name][start : start + len(values)] = values
    group["complete"][shard] = 1
