"""Damaged files of every format: refused in one line, or read as finite frames; and never in place of an earlier result."""

from __future__ import annotations

import contextlib
import json
import logging
import resource
import shutil
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

pytest.importorskip("h5py")
pytest.importorskip("zarr")
pytest.importorskip("astropy")
pytest.importorskip("OpenEXR")

import h5py
import tifffile
import zarr
from astropy.io import fits

import invert.__main__ as invert_command
import invert.track as track_command
from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata
from correlograph.files.captured_frames import read_capture
from correlograph.files.exr_frames import FrameHeader, write_frame
from correlograph.version import version
from tests.fuzz.test_fuzz import drawn, is_one_line, refused
from tests.light import letter_cells, thrown

SHAPE, FRAMES = (300, 340), 3
MAX_BYTES, MAX_SECONDS = 2 * 2**30, 60.0

pytestmark = pytest.mark.slow


def pages() -> np.ndarray:
    rng = np.random.default_rng(5)
    light = np.stack([thrown(letter_cells("F"), SHAPE, 160, rng)[: SHAPE[0], : SHAPE[1]] for _ in range(FRAMES)])
    return (100 + rng.poisson(40.0 * light)).clip(0, 65535).astype(np.uint16)


def write_hdf5(folder: Path, frames: np.ndarray, **options: object) -> None:
    with h5py.File(folder / "run.h5", "w") as opened:
        opened.create_dataset("entry/data", data=frames, **options)


def write_raw(folder: Path, frames: np.ndarray) -> None:
    (folder / "run.raw").write_bytes(frames.astype("<u2").tobytes())
    described = {"width": SHAPE[1], "height": SHAPE[0], "pixel_format": "Mono16", "header_bytes": 0}
    (folder / "run.raw.json").write_text(json.dumps(described))


def write_exr(folder: Path, frames: np.ndarray) -> None:
    for number, frame in enumerate(frames):
        header = FrameHeader(532e-9, 6.9e-6, 1.0, 0.125, 1, number, "0" * 64, version())
        write_frame(folder / f"frame_{number:04d}.exr", frame.astype(np.float32), header)


WRITERS: dict[str, Callable[[Path, np.ndarray], object]] = {
    "tiff": lambda folder, frames: [tifffile.imwrite(folder / f"{n}.tif", one) for n, one in enumerate(frames)],
    "packed tiff": lambda folder, frames: tifffile.imwrite(
        folder / "run.tif", frames, photometric="minisblack", compression="zlib"
    ),
    "imagej": lambda folder, frames: tifffile.imwrite(folder / "run.tif", frames, photometric="minisblack", imagej=True),
    "ome": lambda folder, frames: tifffile.imwrite(folder / "run.ome.tif", frames, photometric="minisblack", ome=True),
    "bigtiff": lambda folder, frames: tifffile.imwrite(folder / "run.tif", frames, photometric="minisblack", bigtiff=True),
    "png": lambda folder, frames: [Image.fromarray(one).save(folder / f"{n}.png") for n, one in enumerate(frames)],
    "jpeg": lambda folder, frames: [
        Image.fromarray((one // 8).clip(0, 255).astype(np.uint8)).save(folder / f"{n}.jpg") for n, one in enumerate(frames)
    ],
    "npy": lambda folder, frames: np.save(folder / "run.npy", frames),
    "npz": lambda folder, frames: np.savez_compressed(folder / "run.npz", frames=frames),
    "hdf5": write_hdf5,
    "packed hdf5": lambda folder, frames: write_hdf5(folder, frames, chunks=(1, 100, 340), compression="gzip"),
    "fits": lambda folder, frames: fits.writeto(folder / "run.fits", frames),
    "zarr 2": lambda folder, frames: zarr.save_array(folder / "run.zarr", frames, zarr_format=2),
    "zarr 3": lambda folder, frames: zarr.save_array(folder / "run.zarr", frames, zarr_format=3),
    "raw": write_raw,
    "exr": write_exr,
}
DAMAGES = (
    "flip",
    "cut",
    "zeros",
    "ones",
    "insert",
    "remove bytes",
    "swap",
    "digits",
    "empty",
    "remove",
    "text",
    "other format",
)


def damage(how: str, held: bytes, place: float, other: bytes) -> bytes | None:
    """The content of a file after damage, of which most hits the first kilobyte; None to remove the file."""
    at = int(place**4 * len(held))
    width = 1 + int(place * 1e4) % 8
    head, middle, tail = held[:at], held[at : at + width], held[at + width :]
    return {
        "flip": lambda: head + bytes(byte ^ (1 << at % 8) for byte in middle[:1]) + middle[1:] + tail,
        "cut": lambda: held[: int(place * len(held))],
        "zeros": lambda: head + bytes(len(middle)) + tail,
        "ones": lambda: head + b"\xff" * len(middle) + tail,
        "insert": lambda: head + b"\x00\x7f\xff" + middle + tail,
        "remove bytes": lambda: head + tail,
        "swap": lambda: head + middle[::-1] + tail,
        "digits": lambda: bytes(57 if 48 <= byte < 57 else byte for byte in held[:at]) + held[at:],
        "empty": lambda: b"",
        "remove": lambda: None,
        "text": lambda: b"no picture\n",
        "other format": lambda: other,
    }[how]()


@pytest.fixture(scope="module")
def captures(tmp_path_factory) -> Path:
    folder, frames = tmp_path_factory.mktemp("formats"), pages()
    for name, write in WRITERS.items():
        (folder / name).mkdir()
        write(folder / name, frames)
    return folder


@pytest.fixture(scope="module")
def earlier(tmp_path_factory, captures) -> Path:
    """A finished result that no failed run may change."""
    folder = tmp_path_factory.mktemp("earlier") / "o"
    invert_command.main([str(captures / "npy"), "-o", str(folder), "--method", "hio"])
    return folder


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")}


def spoil(folder: Path, number: int, damages: list[tuple[str, float]], other: bytes) -> None:
    """Damage one file of a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    file = files[number % len(files)]
    for how, place in damages:
        changed = damage(how, file.read_bytes(), place, other)
        if changed is None:
            return file.unlink()
        file.write_bytes(changed)
    return None


def fresh_peak_bytes() -> int:
    """Return the memory in use, and let the peak begin there: tests before this one in the same process had peaks of their own."""
    with contextlib.suppress(OSError):  # only Linux can; elsewhere, the peak of earlier tests stays
        Path("/proc/self/clear_refs").write_text("5")
    return peak_bytes()


def peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def read(folder: Path) -> None:
    try:
        frames = list(read_capture([folder], CameraMetadata()).frames)
    except InputError as error:
        assert is_one_line(error), error  # noqa: PT017 - not every example is refused
    else:
        assert all(np.isfinite(frame).all() for frame in frames)


@drawn(80)
@given(
    kind=st.sampled_from(sorted(WRITERS)),
    number=st.integers(0, 99),
    damages=st.lists(st.tuples(st.sampled_from(DAMAGES), st.floats(0.0, 1.0)), min_size=1, max_size=3),
    use=st.sampled_from(["read", "read", "read", "invert", "track", "dark"]),
)
def test_damaged_frames(tmp_path_factory, caplog, command, captures, earlier, kind, number, damages, use):
    work = tmp_path_factory.mktemp("damaged")
    frames, whole = work / "frames", captures / "npy"
    shutil.copytree(captures / kind, frames)
    spoil(frames, number, damages, (captures / "png" / "0.png").read_bytes())
    caplog.clear()
    begin, before, in_use = time.monotonic(), content(earlier), fresh_peak_bytes()
    commands = {
        "invert": (invert_command.main, frames, "-o", earlier, "--method", "hio", "--overwrite"),
        "track": (track_command.main, frames, "-o", work / "path"),
        "dark": (invert_command.main, whole, "-o", work / "o", "--method", "hio", "--dark", frames),
    }
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("default")
        warnings.simplefilter("ignore", ResourceWarning)  # as Python does; decoders leave damaged files to the collector
        if use == "read":
            read(frames)
        else:
            code, _, err = command(*commands[use])
            lines = [f"{line}\n" for line in err.splitlines() if line.startswith("error: ")]
            if refused(code, "".join(lines)) and use == "invert":
                assert content(earlier) == before
    # without a handler of its own, a logger writes to the terminal
    loud = [one for one in caplog.records if one.levelno >= logging.WARNING and not logging.getLogger(one.name).handlers]
    assert [one.getMessage() for one in loud] == []
    assert use == "read" or [str(one.message) for one in warned] == []
    assert time.monotonic() - begin < MAX_SECONDS
    assert peak_bytes() - in_use < MAX_BYTES
    shutil.rmtree(work)
