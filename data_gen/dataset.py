"""Datasets for torch: samples directly from a Zarr store, or all targets in memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import zarr

from correlograph.errors import InputError
from correlograph.files.store import Schema, arguments_of, open_complete, read_array, read_part
from correlograph.lags import LAGS
from correlograph.ranges import LAG_COUNT
from data_gen.store import dataset_schema


def open_dataset(address: str) -> zarr.Group:
    """Open a finished dataset for reading. Raises InputError if it is missing, unfinished, damaged or of another kind."""
    return open_complete(address, dataset_schema_of(address))


def dataset_schema_of(address: str) -> Schema:
    """Return the schema that a stored dataset should have, from its kind of measurement and its number of lags."""
    arguments = arguments_of(address, "dataset").get("arguments")
    found = arguments.get("measurement") if isinstance(arguments, dict) else None
    lags = arguments.get("lags", LAGS) if isinstance(arguments, dict) else LAGS
    return dataset_schema(found if found in ("noise-model", "render") else "none", lags if LAG_COUNT.holds(lags) else LAGS)


class DatasetSplit(torch.utils.data.Dataset):
    """Samples of one split, as dicts of float32 tensors: albedo (64, 64), 0 to 1, and the measurement if there is one.

    A part of the store is verified when a sample of it is first read. Raises InputError if it is damaged.
    """

    def __init__(self, address: str, *, validation: bool = False) -> None:
        self._address, self._group, self._schema = address, open_dataset(address), dataset_schema_of(address)
        self._rows = np.flatnonzero(read_array(self._group, address, "split", self._schema) == int(validation))
        self._names = [name for name in self._schema.arrays if name not in ("albedo", "split")]
        self._verified: set[int] = set()

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        row = int(self._rows[index])
        if (part := row // self._schema.part) not in self._verified:
            for name in ("albedo", *self._names):
                read_part(self._group, self._address, name, part, self._schema)
            self._verified.add(part)
        sample = {name: torch.from_numpy(np.asarray(self._group[name][row], np.float32)) for name in self._names}
        sample["albedo"] = torch.from_numpy(np.asarray(self._group["albedo"][row], np.float32) / np.float32(255.0))
        return sample


def load_targets(address: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Load all training and all validation targets, uint8 (n, 64, 64) each."""
    group = open_dataset(address)
    albedo, split = (read_array(group, address, name, dataset_schema_of(address)) for name in ("albedo", "split"))
    if split.all() or not split.any():
        raise InputError(
            "dataset",
            "targets for training and for validation",
            f"one kind only among {len(split)} in {address}",
            "make a larger one",
        )
    return torch.from_numpy(albedo[split == 0]), torch.from_numpy(albedo[split == 1])


def manifest(address: str) -> dict[str, Any]:
    """Return the manifest of a dataset."""
    return open_dataset(address).attrs.asdict()
