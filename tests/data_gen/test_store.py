"""Stores of samples: interrupted at any write, they can be continued."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import numpy as np
import pytest

from correlograph.errors import InputError
from correlograph.files.store import Schema, begin, missing_parts, write_part

SCHEMA = Schema("set", "a test", 1, {"a": ((3, 2), "f4"), "b": ((), "u1")}, part=4, chunk=2)


def test_a_store_that_was_interrupted_at_its_creation_is_created_again(tmp_path, monkeypatch):
    """At every rename of a finished file to its final name, with all arguments or none."""
    rename = Path.replace
    arguments = {"seed": 1, "count": 8, "source": "a"}
    for allowed in count():
        left = iter(range(allowed))

        def replace(self, target, left=left):
            if next(left, None) is None:
                raise RuntimeError
            return rename(self, target)

        address = str(tmp_path / f"{allowed}.zarr")
        monkeypatch.setattr(Path, "replace", replace)
        try:
            begin(address, SCHEMA, arguments, 8)
            is_whole = True
        except RuntimeError:
            is_whole = False
        monkeypatch.setattr(Path, "replace", rename)
        for leftover in tmp_path.rglob("*.partial"):
            leftover.unlink()
        assert len(missing_parts(begin(address, SCHEMA, arguments, 8), address, SCHEMA)) == 2
        if is_whole:
            break
    assert allowed > 3
    with pytest.raises(InputError, match="source"):
        begin(address, SCHEMA, arguments | {"source": "b"}, 8)


def test_marks_that_a_loss_of_power_has_emptied_are_damage(tmp_path):
    address = str(tmp_path / "set.zarr")
    group = begin(address, SCHEMA, {"seed": 1}, 8)
    write_part(group, SCHEMA, 1, {"a": np.ones((4, 3, 2), np.float32), "b": np.ones(4, np.uint8)})
    assert missing_parts(group, address, SCHEMA) == [0]
    (mark,) = [path for path in (tmp_path / "set.zarr" / "complete" / "c").rglob("*") if path.is_file()]
    mark.write_bytes(b"")
    with pytest.raises(InputError, match="marks that cannot be read"):
        missing_parts(begin(address, SCHEMA, {"seed": 1}, 8), address, SCHEMA)
