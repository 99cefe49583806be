"""Datasets for torch: samples straight from a Zarr store, or all targets in memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import zarr

from data_gen.store import missing_shards
from radiometry.errors import InputError


def open_dataset(address: str) -> zarr.Group:
    """Open a finished dataset for reading; InputError where there is none or it is unfinished."""
    try:
        group = zarr.open_group(address, mode="r")
        missing = missing_shards(group)
    except (OSError, KeyError, ValueError):
        raise InputError("dataset", "a dataset made by python -m data_gen", f"none at {address}", "check the address") from None
    if missing:
        raise InputError("dataset", "a complete dataset", f"{len(missing)} shards missing in {address}",
                         "run the same python -m data_gen again")
    return group


class Samples(torch.utils.data.Dataset):
    """Samples of one split as dicts of float32 tensors: albedo (64, 64), 0 to 1, and whatever measurement there is."""

    def __init__(self, address: str, *, validation: bool = False) -> None:
        self._group = open_dataset(address)
        self._rows = np.flatnonzero(np.asarray(self._group["split"]) == int(validation))
        self._names = [name for name in ("autocorrelation", "floor_over_peak", "dof") if name in self._group]

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        row = int(self._rows[index])
        sample = {name: torch.from_numpy(np.asarray(self._group[name][row], np.float32)) for name in self._names}
        sample["albedo"] = torch.from_numpy(np.asarray(self._group["albedo"][row], np.float32) / np.float32(255.0))
        return sample


def load_targets(address: str) -> tuple[torch.Tensor, torch.Tensor]:
    """All training and all validation targets in memory, uint8 (n, 64, 64) each."""
    group = open_dataset(address)
    albedo, split = np.asarray(group["albedo"]), np.asarray(group["split"])
    if split.all() or not split.any():
        raise InputError("dataset", "targets for training and for validation", f"one kind only among {len(split)} in {address}",
                         "make a larger one")
    return torch.from_numpy(albedo[split == 0]), torch.from_numpy(albedo[split == 1])


def manifest(address: str) -> dict[str, Any]:
    """What a dataset was made of."""
    return open_dataset(address).attrs.asdict()
