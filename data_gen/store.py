"""Content of a dataset: targets and their measurements.

Arrays: `albedo` uint8 (n, 64, 64), 255 for albedo 1; `split` uint8 (n,), 0 training, 1 validation. Unless the dataset holds targets
only: `autocorrelation` float16 (n, 127, 127) in units of (r*r)(0), zero lag at [63, 63], `floor_over_peak` and `dof` float32 (n,).
The manifest is stored in the attributes of the group; `correlograph/files/store.py` keeps a store complete.
"""

from __future__ import annotations

from correlograph.files.store import Schema
from correlograph.lags import LAGS, lag_grid
from data_gen.targets import BLOCK


def pair_bytes(lags: int) -> int:
    """Return the bytes of a sample with its measurement; targets are compressed about sixteenfold."""
    grid = lag_grid(lags)
    return grid.object_side**2 // 16 + 2 * grid.side**2 + 8


def shard_size(measurement: str) -> int:
    """Return the number of samples of one shard (one file per array, one unit of work): a minute of rendering, or seconds of
    anything else."""
    return BLOCK if measurement == "render" else 32 * BLOCK


def dataset_schema(measurement: str, lags: int = LAGS) -> Schema:
    """Return the schema of a dataset with this measurement and number of lags."""
    side, lag_side = lag_grid(lags).object_side, lag_grid(lags).side
    arrays: dict[str, tuple[tuple[int, ...], str]] = {"albedo": ((side, side), "uint8"), "split": ((), "uint8")}
    if measurement != "none":
        arrays |= {
            "autocorrelation": ((lag_side, lag_side), "float16"),
            "floor_over_peak": ((), "float32"),
            "dof": ((), "float32"),
        }
    return Schema("dataset", "python -m data_gen", 2, arrays, shard_size(measurement), BLOCK)
