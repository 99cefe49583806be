"""Files of many frames, as cameras and other programs write them: read exactly, one by one, or refused in one line."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
import tifffile
from PIL import Image

import correlograph as cg
from correlograph.errors import InputError
from correlograph.files import captured_frames as capture_module
from correlograph.files.captured_frames import read_capture
from correlograph.files.file_frames import FileFrames
from correlograph.files.stacks import open_stack
from invert.tracking.tracker import track
from tests.invert.test_tracking import drifting

COUNT, SHAPE = 3, (131, 170)
KINDS = ("uint8", "uint16", "uint32", "int16", "float32", "float64")


def frames_of(kind: str) -> np.ndarray:
    """Asymmetric frames of a type."""
    return np.random.default_rng(5).integers(0, 200, (COUNT, *SHAPE)).astype(kind)


def read(path) -> np.ndarray:
    stack = open_stack(path)
    return np.stack([stack.read(number)[0] for number in range(stack.count)])


TIFFS = {
    "plain": {},
    "big": {"bigtiff": True},
    "big-endian": {"byteorder": ">"},
    "tiled": {"tile": (64, 80)},
    "strips": {"rowsperstrip": 7},
    "deflate": {"compression": "zlib"},
    "predictor": {"compression": "zlib", "predictor": True},
    "imagej": {"imagej": True},
    "ome": {"ome": True, "metadata": {"axes": "TYX"}},
    "contiguous": {"contiguous": True},
    "described": {"metadata": {"axes": "ZYX", "spacing": 3.45}},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("variant", TIFFS)
def test_tiff_stacks(tmp_path, variant, kind):
    if variant == "imagej" and kind not in ("uint8", "uint16", "float32"):
        pytest.skip("ImageJ has no such type")
    if variant == "predictor" and kind.startswith("float"):
        pytest.skip("another predictor")
    frames = frames_of(kind)
    tifffile.imwrite(tmp_path / "a.tif", frames, photometric="minisblack", **TIFFS[variant])
    np.testing.assert_array_equal(read(tmp_path / "a.tif"), frames)


def test_stacks_of_pillow_and_of_pages_added_one_by_one(tmp_path):
    frames = frames_of("uint8")
    first, *others = map(Image.fromarray, frames)
    first.save(tmp_path / "a.tiff", save_all=True, append_images=others, compression="tiff_lzw")
    np.testing.assert_array_equal(read(tmp_path / "a.tiff"), frames)
    with tifffile.TiffWriter(tmp_path / "b.tif") as writer:
        for frame in frames_of("uint16"):
            writer.write(frame, contiguous=False)
    np.testing.assert_array_equal(read(tmp_path / "b.tif"), frames_of("uint16"))


@pytest.mark.parametrize("kind", [*KINDS, "float16", ">u2"])
def test_numpy_arrays(tmp_path, kind):
    frames = frames_of(kind)
    np.save(tmp_path / "a.npy", frames)
    np.savez_compressed(tmp_path / "a.npz", frames=frames)
    np.save(tmp_path / "fortran.npy", np.asfortranarray(frames))
    np.save(tmp_path / "axes.npy", frames[:, None])
    for name in ("a.npy", "a.npz", "fortran.npy", "axes.npy"):
        np.testing.assert_array_equal(read(tmp_path / name), frames.astype(np.float32))


@pytest.mark.parametrize(
    "options", [{}, {"chunks": (1, 64, 64)}, {"compression": "gzip", "shuffle": True}, {"maxshape": (None, *SHAPE)}]
)
def test_hdf5_datasets(tmp_path, options):
    h5py = pytest.importorskip("h5py")
    frames = frames_of("uint16")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("entry/instrument/detector/data", data=frames, **options)
        file["entry/exposure"] = 0.125
    np.testing.assert_array_equal(read(tmp_path / "a.h5"), frames)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["entry/dark"] = frames[:, ::-1]
    with pytest.raises(InputError, match="name the dataset, such as a"):
        open_stack(tmp_path / "a.h5")
    np.testing.assert_array_equal(read(tmp_path / "a.h5::/entry/dark"), frames[:, ::-1])
    with pytest.raises(InputError, match="a dataset /entry/none"):
        open_stack(tmp_path / "a.h5::/entry/none")


def test_fits_images(tmp_path):
    fits = pytest.importorskip("astropy.io.fits")
    frames = frames_of("int16")
    fits.writeto(tmp_path / "a.fits", frames)
    np.testing.assert_array_equal(read(tmp_path / "a.fits"), frames)
    unsigned = frames.astype(np.uint16) + 40_000  # FITS stores these as integers with an offset
    fits.writeto(tmp_path / "b.fits", unsigned)
    np.testing.assert_array_equal(read(tmp_path / "b.fits"), unsigned)


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.npy", np.zeros((200, 200, 3)), "monochrome"),
        ("a.npy", np.zeros((2, 3, 150, 150)), "monochrome"),
        ("a.npy", np.zeros((0, 150, 150)), "monochrome"),
        ("a.npy", np.zeros((3, 150, 150), complex), "numbers"),
        ("a.h5", b"no file of HDF5", "a file that can be read"),
        ("a.fits", b"no FITS", "a file that can be read"),
        ("a.tif", b"II*\0\x08\0\0\0", "none in a.tif"),
        ("a.npz", b"PK\x03\x04", "a file that can be read"),
    ],
)
def test_unusable_stacks_are_one_line(tmp_path, name, content, expected):
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    else:
        np.save(tmp_path / name, content)
    with pytest.raises(InputError, match=expected) as found:
        read_capture([tmp_path / name], cg.CameraMetadata())
    assert "\n" not in str(found.value)


def test_a_large_capture_gives_the_same_estimate_in_the_memory_of_a_few_frames(tmp_path, rng, monkeypatch):
    """Sixty frames of one megapixel, a dark frame and a mask; the frames together are 240 MB."""
    shape = (1000, 1000)
    np.save(tmp_path / "dark.npy", np.full(shape, 2, np.uint8) + rng.integers(0, 2, shape, np.uint8))
    mask = np.ones(shape, np.uint8)
    mask[:, :40] = 0
    np.save(tmp_path / "mask.npy", mask)
    (tmp_path / "in").mkdir()
    stack = np.lib.format.open_memmap(tmp_path / "in" / "a.npy", "w+", np.uint8, (60, *shape))
    for number in range(60):
        stack[number] = rng.poisson(3.0, shape)
    stack.flush()
    settings = {
        "corrections": cg.Corrections(tmp_path / "dark.npy", None, tmp_path / "mask.npy"),
        "patch": 128,
        "quality": "fast",
        "method": "classical",
    }
    kept = cg.reconstruct(tmp_path / "in" / "a.npy", **settings)
    monkeypatch.setattr(capture_module, "MAX_KEPT_BYTES", 0)
    tracemalloc.start()
    streamed = cg.reconstruct(tmp_path / "in" / "a.npy", **settings)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_array_equal(streamed.estimate.values, kept.estimate.values)
    assert streamed.estimate.record.frames == 60
    assert peak < 120e6, peak


def test_a_dim_capture_that_is_read_again_has_the_path_of_one_that_is_kept(tmp_path, monkeypatch, rng):
    """The band of dim frames is measured in parts of more than 32 of them, the second of which was refused as a copy."""
    path = np.arange(48)[:, None] * np.array([1.3, -0.8])
    np.save(tmp_path / "a.npy", np.array(drifting(rng, path, 0.02)).astype(np.uint8))
    kept = track(read_capture([tmp_path / "a.npy"], cg.CameraMetadata()))
    monkeypatch.setattr(capture_module, "MAX_KEPT_BYTES", 0)
    again = read_capture([tmp_path / "a.npy"], cg.CameraMetadata())
    assert isinstance(again.frames, FileFrames)
    np.testing.assert_array_equal(track(again).path_pixels, kept.path_pixels)
    assert [one.tobytes() for one in again.frames[40:]] == [again.frames[number].tobytes() for number in range(40, 48)]


def test_a_copy_in_a_stack_is_named(tmp_path):
    frames = frames_of("uint16")
    np.save(tmp_path / "a.npy", np.concatenate((frames, frames[1:2])))
    with pytest.raises(InputError, match="repeats an earlier frame"):
        read_capture([tmp_path / "a.npy"], cg.CameraMetadata())


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    (tmp_path / "a.h5").touch()
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(InputError, match="pip install h5py"):
        open_stack(tmp_path / "a.h5")
