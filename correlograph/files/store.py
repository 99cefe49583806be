"""Zarr stores that are filled part by part: ownership, schema, completeness.

The attributes of a store hold an ownership attribute, the version of the schema, and the arguments of its creation. `complete`
is 1 for each complete part, and `crc32` holds the checksums. The program deletes and overwrites only its own files.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.errors import GroupNotFoundError

from correlograph.errors import InputError

OWNER = "correlograph"


@dataclass(frozen=True)
class Schema:
    """Content of a kind of store.

    Attributes:
        kind: `dataset` or `warm starts`.
        made_by: command that writes it, for messages.
        version: version of the format; other versions are refused.
        arrays: shape of one sample and dtype by name.
        part: number of samples written together, one file per array.
        chunk: number of samples compressed together.
    """

    kind: str
    made_by: str
    version: int
    arrays: Mapping[str, tuple[tuple[int, ...], str]]
    part: int
    chunk: int

    @property
    def mark(self) -> dict[str, Any]:
        return {"made_by": f"{OWNER} {self.kind}", "format": self.version}


def store_address(text: str) -> str:
    """Return an address from the command line: `file://` is a path; addresses in memory are refused."""
    if text.startswith("memory:"):
        raise InputError("store", "an address that other processes can open", text, "give a path")
    return text.removeprefix("file://")


def begin(address: str, schema: Schema, arguments: dict[str, Any], count: int) -> zarr.Group:
    """Open a store to continue it, or create an empty one.

    Raises InputError for any other content, and for a store that was created with other arguments.
    """
    group = _open(address, "r+", schema.kind)
    if group is None:
        _check_empty(address, schema.kind)
        try:
            group = zarr.create_group(address, attributes=schema.mark)
        except (OSError, ValueError, ImportError) as error:
            raise _unusable(address, schema.kind, error) from None
    _check_mark(group, address, schema)
    found = {key: value for key, value in group.attrs.asdict().items() if key not in schema.mark}
    if not found:
        _create_arrays(group, address, schema, count)
        group.attrs.put(schema.mark | arguments)  # at once and last; a store without arguments counts as not created
        return group
    for key, value in arguments.items():
        if found.get(key) != value:
            raise InputError(
                schema.kind,
                f"the {key} that {address} was begun with",
                _difference(found.get(key), value),
                "ask again with the same, or choose another address",
            )
    _check_arrays(group, address, schema)
    if "://" not in address:
        _remove_partial_files(Path(address), schema)
    return group


def _remove_partial_files(store: Path, schema: Schema) -> None:
    """Remove files that a killed run was writing. Zarr gives them a name of 32 hexadecimal digits that ends in .partial."""
    for folder in (store, *(store / name for name in (*schema.arrays, "complete", "crc32"))):
        for left in folder.rglob("*.partial") if folder != store else folder.glob("*.partial"):
            if re.fullmatch(r".*\.[0-9a-f]{32}\.partial", left.name):
                left.unlink()


def arguments_of(address: str, kind: str) -> dict[str, Any]:
    """Return the arguments that a store was created with, without a check that it is complete; empty if there is no store."""
    group = _open(address, "r", kind)
    return {} if group is None else group.attrs.asdict()


def open_complete(address: str, schema: Schema) -> zarr.Group:
    """Open a finished store for reading. Raises InputError if it is missing, unfinished, damaged or of another kind."""
    group = _open(address, "r", schema.kind)
    if group is None:
        raise InputError(schema.kind, f"one made by {schema.made_by}", f"none at {address}", "check the address")
    _check_mark(group, address, schema)
    _check_arrays(group, address, schema)
    if missing := missing_parts(group, address, schema):
        found = f"{len(missing)} of {group['complete'].shape[0]} parts missing in {address}"
        raise InputError(schema.kind, "a complete one", found, f"run the same {schema.made_by} again")
    for name in schema.arrays:
        array = group[name]
        if array.nchunks_initialized < group["complete"].shape[0] * (schema.part // schema.chunk):
            raise _damage_error(address, schema, f"files of {name} missing")
    return group


def read_array(group: zarr.Group, address: str, name: str, schema: Schema) -> np.ndarray:
    """Read a whole array and verify its checksums."""
    values = np.empty(group[name].shape, group[name].dtype)
    for part in range(group["complete"].shape[0]):
        values[part * schema.part : (part + 1) * schema.part] = read_part(group, address, name, part, schema)
    return values


def read_part(group: zarr.Group, address: str, name: str, part: int, schema: Schema) -> np.ndarray:
    """Read one part of an array and verify its checksum."""
    try:
        values = np.asarray(group[name][part * schema.part : (part + 1) * schema.part])
        known = group["crc32"][part, list(schema.arrays).index(name)]
    except Exception as error:  # codecs raise their own exceptions
        raise _damage_error(address, schema, f"{name} that cannot be read ({_one_line(error)})") from None
    if _crc(values) != int(known):
        raise _damage_error(address, schema, f"a wrong checksum in part {part} of {name}")
    return values


def read_rows(group: zarr.Group, address: str, name: str, rows: np.ndarray, schema: Schema) -> np.ndarray:
    """Read some samples of an array; Zarr's own checks apply; the `crc32` of whole parts is not verified."""
    try:
        return np.stack([np.asarray(group[name][int(row)]) for row in rows])
    except Exception as error:  # codecs raise their own exceptions
        raise _damage_error(address, schema, f"{name} that cannot be read ({_one_line(error)})") from None


def missing_parts(group: zarr.Group, address: str, schema: Schema) -> list[int]:
    """Return the incomplete parts. Raises InputError if the marks cannot be read."""
    try:
        return np.flatnonzero(np.asarray(group["complete"]) == 0).tolist()
    except Exception as error:  # codecs raise their own exceptions
        raise _damage_error(address, schema, f"marks that cannot be read ({_one_line(error)})") from None


def write_part(group: zarr.Group, schema: Schema, part: int, arrays: Mapping[str, np.ndarray]) -> None:
    """Write one part of every array, then mark it complete."""
    start = part * schema.part
    with zarr.config.set({"array.write_empty_chunks": True}):  # distinguishes a file of zeros from a missing one
        for name, values in arrays.items():
            group[name][start : start + len(values)] = values
        group["crc32"][part] = [_crc(arrays[name]) for name in schema.arrays]
        group["complete"][part] = 1


def _crc(values: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(values).tobytes())


def _open(address: str, mode: str, kind: str) -> zarr.Group | None:
    """Open the group at an address; None without one."""
    try:
        return zarr.open_group(address, mode=mode)
    except (GroupNotFoundError, FileNotFoundError):
        return None
    except Exception as error:  # fsspec, aiohttp and damaged metadata raise their own exceptions
        raise _unusable(address, kind, error) from None


def _check_empty(address: str, kind: str) -> None:
    """Refuse a file, or a folder that is not empty."""
    if "://" in address:
        return
    path = Path(address)
    if not address.strip() or path.is_file() or (path.is_dir() and any(path.iterdir())):
        raise InputError(
            kind,
            "a new name, an empty folder or a store of this program",
            f"other files in {address!r}",
            "choose another address; nothing of yours is overwritten",
        )


def _check_mark(group: zarr.Group, address: str, schema: Schema) -> None:
    found = {key: group.attrs.asdict().get(key) for key in schema.mark}
    if found["made_by"] != schema.mark["made_by"]:
        raise InputError(
            schema.kind,
            f"a store made by {schema.made_by}",
            f"another Zarr group at {address}",
            "choose another address, or make the store again if an older version wrote it",
        )
    if found["format"] != schema.version:
        raise InputError(
            schema.kind,
            f"format {schema.version}",
            f"format {found['format']!r} at {address}",
            f"make it again with {schema.made_by}",
        )


def _create_arrays(group: zarr.Group, address: str, schema: Schema, count: int) -> None:
    """Create the arrays of an empty store; arrays of a stopped run are kept."""
    parts = -(-count // schema.part)
    try:
        for name, (shape, dtype) in schema.arrays.items():
            if name not in group:
                compressors = None if dtype == "float16" else "auto"  # noise does not compress
                group.create_array(
                    name,
                    shape=(count, *shape),
                    dtype=dtype,
                    chunks=(schema.chunk, *shape),
                    shards=(schema.part, *shape),
                    compressors=compressors,
                )
        if "crc32" not in group:
            group.create_array(
                "crc32", shape=(parts, len(schema.arrays)), dtype="uint32", chunks=(1, len(schema.arrays)), compressors=None
            )
        if "complete" not in group:
            group.create_array("complete", shape=(parts,), dtype="uint8", chunks=(1,), compressors=None)
    except (OSError, ValueError, MemoryError) as error:
        raise _unusable(address, schema.kind, error) from None
    _check_arrays(group, address, schema)


def _check_arrays(group: zarr.Group, address: str, schema: Schema) -> None:
    """Check the arrays of a schema: equal lengths, checksums, completeness."""
    try:
        held = {name: group[name] for name in (*schema.arrays, "crc32", "complete")}
        count = held[next(iter(schema.arrays))].shape[0]
        wanted = {name: ((count, *shape), np.dtype(dtype)) for name, (shape, dtype) in schema.arrays.items()}
        parts = -(-count // schema.part)
        wanted |= {"crc32": ((parts, len(schema.arrays)), np.dtype("uint32")), "complete": ((parts,), np.dtype("uint8"))}
        wrong = [name for name, (shape, dtype) in wanted.items() if held[name].shape != shape or held[name].dtype != dtype]
    except Exception as error:  # damaged metadata raises any exception
        raise _damage_error(address, schema, f"arrays that cannot be read ({_one_line(error)})") from None
    if wrong or count == 0:
        raise _damage_error(address, schema, f"{wrong[0]} of another shape or dtype" if wrong else "no samples")


def _damage_error(address: str, schema: Schema, found: str) -> InputError:
    return InputError(schema.kind, f"one as {schema.made_by} left it", f"{found} at {address}", "delete it and make it again")


def _unusable(address: str, kind: str, error: Exception) -> InputError:
    return InputError(kind, "an address that can be read and written", f"{address} ({_one_line(error)})", "use another value")


def _one_line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"


def _difference(found: Any, wanted: Any) -> str:
    """Describe, for an error message, how a stored attribute differs from the requested one."""
    if isinstance(found, dict) and isinstance(wanted, dict):
        keys = [key for key in {**found, **wanted} if found.get(key) != wanted.get(key)]
        return ", ".join(f"{key} {found.get(key)!r:.60} there and {wanted.get(key)!r:.60} here" for key in keys)
    return "another" if found is not None else "none"
