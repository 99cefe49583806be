"""Parts of a file that were not written are damage, not darkness; types that are no numbers are refused before they are decoded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from correlograph.errors import InputError
from correlograph.files.stacks import open_stack

SHAPE = (3, 150, 160)


def test_datasets_without_their_data_are_refused(tmp_path):
    h5py = pytest.importorskip("h5py")
    frames = np.random.default_rng(0).integers(1, 9, SHAPE).astype(np.uint16)
    frames[0].tofile(tmp_path / "short.bin")
    with h5py.File(tmp_path / "file.h5", "w") as file:
        file["whole"] = frames
        file.create_dataset("unwritten", SHAPE, "u2")
        part = file.create_dataset("part", SHAPE, "u2", chunks=(1, *SHAPE[1:]))
        part[0] = frames[0]
        layout = h5py.VirtualLayout(SHAPE, "u2")
        layout[0] = h5py.VirtualSource("absent.h5", "frames", SHAPE[1:])
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("external", SHAPE, "u2", external=[("short.bin", 0, h5py.h5f.UNLIMITED)])
    np.testing.assert_array_equal(open_stack(Path(f"{tmp_path}/file.h5::whole")).read(2)[0], frames[2])
    np.testing.assert_array_equal(open_stack(Path(f"{tmp_path}/file.h5::part")).read(0)[0], frames[0])
    for name, number in (("unwritten", 0), ("part", 1), ("virtual", 0), ("external", 2)):
        with pytest.raises(InputError, match="frame"):
            open_stack(Path(f"{tmp_path}/file.h5::{name}")).read(number)


def test_missing_chunks_of_a_store_are_refused(tmp_path):
    zarr = pytest.importorskip("zarr")
    store = zarr.open(str(tmp_path / "run.zarr"), mode="w", shape=SHAPE, chunks=(1, *SHAPE[1:]), dtype="u2")
    store[0] = 5
    stack = open_stack(tmp_path / "run.zarr")
    assert stack.read(0)[0].mean() == 5.0
    with pytest.raises(InputError, match="none for frame 1"):
        stack.read(1)


def test_objects_are_refused_before_they_are_decoded(tmp_path):
    """A store of Python objects may name a filter that unpickles them."""
    import json

    folder = tmp_path / "run.zarr"
    folder.mkdir()
    description = {
        "zarr_format": 2,
        "shape": list(SHAPE),
        "chunks": [1, *SHAPE[1:]],
        "dtype": "|O",
        "compressor": None,
        "fill_value": None,
        "order": "C",
        "filters": [{"id": "pickle", "protocol": 5}],
    }
    (folder / ".zarray").write_text(json.dumps(description))
    (folder / "0.0.0").write_bytes(b"cos\nsystem\n(S'touch " + str(tmp_path / "ran").encode() + b"'\ntR.")
    with pytest.raises(InputError):
        open_stack(folder).read(0)
    assert not (tmp_path / "ran").exists()
