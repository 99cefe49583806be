"""Raw frames with a description, and Zarr arrays: read exactly, or refused in one line."""

from __future__ import annotations

import json

import numpy as np
import pytest
import zarr

import correlograph as cg
from correlograph.errors import InputError
from correlograph.files.captured_frames import find_frames, read_capture
from correlograph.files.stacks import open_stack
from invert.batch.captures import Job
from invert.request import Request

SHAPE = (5, 130, 148)


def pack(pixels: np.ndarray, name: str) -> bytes:
    """Write pixels bit by bit from the definition of each format."""
    flat = [int(pixel) for pixel in pixels.ravel()]
    if name.endswith("p"):
        bits = int(name[4:-1])
        whole = sum(pixel << bits * place for place, pixel in enumerate(flat))
        return whole.to_bytes(len(flat) * bits // 8, "little")
    if name.endswith("Packed"):
        low = int(name[4:-6]) - 8
        triples = zip(flat[::2], flat[1::2], strict=True)
        mask = (1 << low) - 1
        return bytes(byte for a, b in triples for byte in (a >> low, (a & mask) | (b & mask) << 4, b >> low))
    return pixels.astype("u1" if name == "Mono8" else "<u2").tobytes()


def write_raw(folder, name: str, header: bytes = b"", **changes):
    bits = int("".join(character for character in name if character.isdigit()))
    pixels = np.random.default_rng(bits).integers(0, 2**bits, SHAPE)
    file = folder / f"{name}.raw"
    file.write_bytes(b"".join(header + pack(frame, name) for frame in pixels))
    described = {"width": SHAPE[2], "height": SHAPE[1], "pixel_format": name, "header_bytes": len(header), **changes}
    (folder / f"{name}.raw.json").write_text(json.dumps(described))
    return file, pixels


NAMES = ["Mono8", "Mono10", "Mono12", "Mono14", "Mono16", "Mono10p", "Mono12p", "Mono10Packed", "Mono12Packed"]


@pytest.mark.parametrize("header", [b"", b"0123456789"])
@pytest.mark.parametrize("name", NAMES)
def test_raw_frames_are_read_exactly(tmp_path, name, header):
    file, pixels = write_raw(tmp_path, name, header)
    stack = open_stack(file)
    assert stack.count == len(pixels)
    for number in (4, 0, 2):
        np.testing.assert_array_equal(stack.read(number)[0], pixels[number].astype(np.float32))
    capture = read_capture([tmp_path], cg.CameraMetadata())
    assert len(capture.frames) == len(pixels)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"width": 77}, "multiple of"),
        ({"width": None}, "width"),
        ({"height": 60.5}, "height"),
        ({"pixel_format": "RGB8"}, "pixel_format"),
        ({"pixel_format": ["Mono8"]}, "pixel_format"),
        ({"header_bytes": -1}, "header_bytes"),
    ],
)
def test_unsuitable_descriptions_are_refused(tmp_path, changes, says):
    file, _ = write_raw(tmp_path, "Mono12p", **changes)
    with pytest.raises(InputError, match=says):
        open_stack(file)


def test_pixels_beyond_the_format_are_refused(tmp_path):
    """Numbers of 16 bits that are said to have 10."""
    file, _ = write_raw(tmp_path, "Mono16", pixel_format="Mono10")
    with pytest.raises(InputError, match="pixels below 1024"):
        open_stack(file).read(0)


def test_a_raw_file_without_a_description_says_how_to_write_one(tmp_path):
    file, _ = write_raw(tmp_path, "Mono8")
    (tmp_path / "Mono8.raw.json").unlink()
    with pytest.raises(InputError, match=r"Mono8\.raw\.json.*pixel_format"):
        open_stack(file)
    (tmp_path / "Mono8.json").write_text("[1]")
    with pytest.raises(InputError, match="an object"):
        open_stack(file)


def test_a_changed_description_is_another_request(tmp_path):
    file, _ = write_raw(tmp_path, "Mono16")
    before = Job(Request()).sha256([file])
    (tmp_path / "Mono16.raw.json").write_text(json.dumps({"width": SHAPE[1], "height": SHAPE[2], "pixel_format": "Mono16"}))
    assert Job(Request()).sha256([file]) != before


def test_zarr_arrays_are_read_exactly(tmp_path):
    pixels = np.random.default_rng(1).integers(0, 4000, SHAPE).astype(np.uint16)
    array = zarr.create_array(str(tmp_path / "run.zarr"), shape=SHAPE, chunks=(1, 32, 32), dtype="uint16")
    array[:] = pixels
    assert find_frames([tmp_path / "run.zarr"]) == find_frames([tmp_path]) == [tmp_path / "run.zarr"]
    stack = open_stack(tmp_path / "run.zarr")
    np.testing.assert_array_equal(np.stack([stack.read(n)[0] for n in range(stack.count)]), pixels.astype(np.float32))
    before = Job(Request()).sha256([tmp_path / "run.zarr"])
    array[2, 3, 4] += 1
    assert Job(Request()).sha256([tmp_path / "run.zarr"]) != before


def test_an_array_of_a_zarr_group_is_named(tmp_path):
    group = zarr.open_group(str(tmp_path / "run.zarr"), mode="w")
    pixels = np.random.default_rng(2).normal(5.0, 1.0, SHAPE).astype(np.float32)
    for name, factor in (("a", 1.0), ("b", 2.0)):
        group.create_array(name, shape=SHAPE, dtype="float32")[:] = factor * pixels
    with pytest.raises(InputError, match=r"run\.zarr::/[ab]"):
        open_stack(tmp_path / "run.zarr")
    named = type(tmp_path)(f"{tmp_path / 'run.zarr'}::/b")
    np.testing.assert_array_equal(open_stack(named).read(3)[0], 2.0 * pixels[3])
    assert find_frames([named]) == [named]
    with pytest.raises(InputError, match="can be read"):
        open_stack(type(tmp_path)(f"{tmp_path / 'run.zarr'}::/c"))
