"""Files of one or many frames, read one frame at a time, so that memory does not grow with their number.

TIFF stacks (also BigTIFF, OME and ImageJ), NPY and NPZ arrays, HDF5 and NeXus datasets, Zarr arrays, FITS images, raw frames with a
description, and files of one frame. `file.h5::/entry/data` names a dataset inside a file, and `run.zarr::/data` an array of a Zarr group.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack
from importlib import import_module
from math import prod
from pathlib import Path
from typing import Any
from weakref import finalize

import numpy as np

from correlograph.errors import InputError
from correlograph.files.decoding import decoding
from correlograph.files.exr_frames import FrameHeader
from correlograph.files.images import (
    MAX_PIXELS,
    as_frame,
    check_tiff_page,
    decode_tiff_page,
    one_of_equal_channels,
    read_image,
)
from correlograph.files.raw_frames import RAW_KIND, RawFrames

DATASET = "::"
"""Separates the name of a file and that of a dataset inside it."""

HDF5_KINDS = {".h5", ".hdf5", ".hdf", ".nxs"}
FITS_KINDS = {".fits", ".fit", ".fts"}
ZARR_KIND = ".zarr"
"""Ending of a folder that is one Zarr store and counts as a file."""

MIN_SIDE = 16
"""Minimum rows and columns of a dataset that may hold frames, where none is named."""

MAX_CHANNELS = 4
"""Length of the last axis of an array up to which it counts as colour channels."""

MAX_ARCHIVE_BYTES = 2**31
"""Maximum size of an NPZ archive, which is read as a whole."""

Frame = tuple[np.ndarray, FrameHeader | None]


def file_of(path: Path) -> Path:
    """Return the file of a name that may end in `::dataset`."""
    return Path(str(path).split(DATASET, 1)[0])


def is_stack(path: Path) -> bool:
    """Return whether a name that may end in `::dataset` is a file, or a folder that is a Zarr store."""
    file = file_of(path)
    return file.is_file() or (file.is_dir() and file.suffix.lower() == ZARR_KIND)


class Stack:
    """Frames of one file.

    Attributes:
        path: the file, and the dataset in it if one was named.
        count: number of frames.
    """

    def __init__(self, path: Path, count: int, read: Callable[[int], Frame]) -> None:
        """Raise InputError for no frames."""
        if count == 0:
            raise InputError("frame", "a file that holds frames", f"none in {path.name}", "leave the file out")
        self.path, self.count, self._read = path, count, read

    def read(self, number: int) -> Frame:
        """Return a frame, float32 (H, W), with its header if the simulator wrote it. Raises InputError if it is damaged."""
        with decoding(self.path):
            return self._read(number)

    def __reduce__(self) -> tuple[Callable[[Path], Stack], tuple[Path]]:
        """Open the file again in the process that loads a pickled stack."""
        return open_stack, (Path(os.path.abspath(self.path)),)


def open_stack(path: Path) -> Stack:
    """Open a file of frames. Raises InputError for files that hold none, and for formats whose package is missing."""
    file, _, dataset = str(path).partition(DATASET)
    kind, source = Path(file).suffix.lower(), Path(file)
    if dataset and kind not in {*HDF5_KINDS, ZARR_KIND}:
        raise InputError("frame", "an HDF5 file or a Zarr store before '::'", source.name, "name the file only")
    with ExitStack() as files, decoding(source):  # closes them on an error, otherwise when the stack is no longer used
        if kind in (".tif", ".tiff"):
            stack = _open_tiff(source, files)
        elif kind in (".npy", ".npz"):
            stack = _open_numpy(source)
        elif kind in HDF5_KINDS:
            stack = _open_hdf5(path, source, dataset, files)
        elif kind in FITS_KINDS:
            stack = _open_fits(source, files)
        elif kind == ZARR_KIND:
            stack = _open_zarr(path, source, dataset)
        elif kind == RAW_KIND:
            stack = _stack_of_array(source, RawFrames(source))
        else:
            stack = Stack(path, 1, lambda _: read_image(source))
        finalize(stack, files.pop_all().close)
        return stack


def _open_tiff(file: Path, files: ExitStack) -> Stack:
    import tifffile

    tiff = files.enter_context(tifffile.TiffFile(file))
    series = tiff.series[0] if tiff.series else None
    pages = len(tiff.pages)
    if series is not None and pages == 1 and len(series.shape) > 2 and tiff.pages.first.samplesperpixel == 1:
        check_tiff_page(tiff.pages.first, file)
        files.close()
        return _stack_of_array(file, tifffile.memmap(file, mode="r"))  # ImageJ describes all frames by one page
    if pages == 1:
        files.close()
        return Stack(file, 1, lambda _: read_image(file))

    def read(number: int) -> Frame:
        page = tiff.pages[number]
        check_tiff_page(page.keyframe, file)
        return as_frame(one_of_equal_channels(decode_tiff_page(page, file)), Path(f"page {number} of {file.name}")), None

    return Stack(file, pages, read)


def _open_numpy(file: Path) -> Stack:
    if file.suffix.lower() == ".npz":
        if file.stat().st_size > MAX_ARCHIVE_BYTES:
            raise InputError("frame", f"an archive up to {MAX_ARCHIVE_BYTES:.2g} bytes", file.name, "save the frames as .npy")
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as archive:
            names = list(archive)
            if len(names) != 1:
                raise InputError("frame", "an archive of one array", f"{len(names)} in {file.name}", "save the frames as .npy")
            return _stack_of_array(file, archive[names[0]])
    array = np.load(file, allow_pickle=False, mmap_mode="r")
    if not isinstance(array, np.ndarray):
        raise InputError("frame", "one array", f"an archive of several in {file.name}", "save it as .npy")
    return _stack_of_array(file, array)


def _open_hdf5(path: Path, file: Path, dataset: str, files: ExitStack) -> Stack:
    h5py = _require("h5py", file)
    opened = files.enter_context(h5py.File(file, "r"))
    if dataset:
        found = opened.get(dataset)
        if not isinstance(found, h5py.Dataset):
            raise InputError("frame", f"a dataset {dataset}", f"none in {file.name}", f"name one of {_image_datasets(opened)}")
        return _stack_of_array(path, found)
    names = _image_datasets(opened)
    if len(names) != 1:
        found = f"{len(names)} in {file.name}"
        named = f", such as {file.name}{DATASET}/{names[0]}" if names else ""
        raise InputError("frame", "one dataset of frames", found, f"name the dataset{named}")
    return _stack_of_array(path, opened[names[0]])


def _open_zarr(path: Path, store: Path, name: str) -> Stack:
    zarr = _require("zarr", store)
    opened = zarr.open(str(store), mode="r", path=name.strip("/"))
    if isinstance(opened, zarr.Group):
        names = [key for key, _ in opened.arrays()]
        if len(names) != 1:
            named = f", such as {store.name}{DATASET}/{names[0]}" if names else ""
            raise InputError("frame", "one array of frames", f"{len(names)} in {path.name}", f"name the array{named}")
        opened = opened[names[0]]
    return _stack_of_array(path, opened)


def _image_datasets(opened: Any) -> list[str]:
    """Return the names of the datasets of an HDF5 file that may hold frames."""
    names: list[str] = []

    def visit(name: str, item: Any) -> None:
        shape = getattr(item, "shape", None)
        if shape is not None and len(shape) in (2, 3) and min(shape[-2:]) >= MIN_SIDE and item.dtype.kind in "uif":
            names.append(name)

    opened.visititems(visit)
    return names


def _open_fits(file: Path, files: ExitStack) -> Stack:
    fits = _require("astropy.io.fits", file)
    opened = files.enter_context(fits.open(file))
    images = [unit for unit in opened if unit.is_image and len(unit.shape) > 1]
    if len(images) != 1:
        raise InputError("frame", "one image or cube", f"{len(images)} in {file.name}", "save one in a file of its own")
    return _stack_of_array(file, _FitsImage(images[0]))


class _FitsImage:
    """A FITS image of which parts can be read, with its scale and offset applied."""

    def __init__(self, unit: Any) -> None:
        self._unit, self.shape = unit, unit.shape

    def __getitem__(self, place: tuple[int, ...]) -> np.ndarray:
        return self._unit.section[(*place, slice(None), slice(None))]


def _stack_of_array(path: Path, array: Any) -> Stack:
    """Return the frames of an array (H, W) or (frames, H, W), which may lie in a file; other axes of length 1 are dropped."""
    shape = array.shape
    has_channels = len(shape) > 2 and shape[-1] <= MAX_CHANNELS
    if len(shape) < 2 or has_channels or int(np.prod(shape[:-2])) != max(shape[:-2], default=1) or 0 in shape:
        found = f"shape {tuple(shape)} in {path.name}"
        raise InputError("frame", "monochrome frames (height, width) or (frames, height, width)", found, "give one channel")
    if shape[-1] * shape[-2] > MAX_PIXELS:
        raise InputError("frame", f"at most {MAX_PIXELS:.3g} pixels", f"{shape[-1] * shape[-2]:.3g} in {path.name}", "crop it")
    if hasattr(array, "dtype") and array.dtype.kind not in "uifb":  # a store may name a filter that runs code for other types
        found = f"{array.dtype} in {path.name}"
        raise InputError("frame", "an array of numbers", found, "convert it to 16-bit integers or floats")
    lacks_data = _lacks_data(path, array)
    count, is_plain = int(np.prod(shape[:-2])), isinstance(array, np.memmap) and array.flags.c_contiguous
    axis = int(np.argmax(shape[:-2])) if count > 1 else 0

    def read(number: int) -> Frame:
        if is_plain:  # pages of a memory map that were read would count as memory of the process
            size = shape[-2] * shape[-1]
            start = array.offset + number * size * array.itemsize
            pixels = np.fromfile(array.filename, array.dtype, size, offset=start).reshape(shape[-2:])
        else:
            pixels = np.array(array[tuple(number if one == axis else 0 for one in range(len(shape) - 2))])
        if lacks_data and not pixels.any():
            found = f"none for frame {number} in {path.name}"
            raise InputError("frame", "data", found, "copy the file again with all parts, or leave the frame out")
        return as_frame(pixels, path), None

    return Stack(path, count, read)


def _lacks_data(path: Path, array: Any) -> bool:
    """Return whether parts of an HDF5 dataset or a Zarr array were not written; libraries read them as zeros.

    Raises InputError for a dataset whose other files are missing or too short, and for one without any data.
    """
    if hasattr(array, "nchunks_initialized"):
        return array.nchunks_initialized < array.nchunks
    if not hasattr(array, "is_virtual"):
        return False
    folder = Path(array.file.filename).parent
    if array.is_virtual:
        others = {folder / source.file_name: 0 for source in array.virtual_sources() if source.file_name != "."}
    else:
        others = {folder / name: offset for name, offset, _ in array.external or ()}
    needed = array.size * array.dtype.itemsize if array.external else 0
    held = sum(max(file.stat().st_size - offset, 0) for file, offset in others.items() if file.is_file())
    missing = next((file for file in others if not file.is_file()), None)
    if missing is not None or held < needed:
        found = f"no {missing}" if missing is not None else f"{held} of {needed} bytes"
        raise InputError("frame", f"the files that {path.name} refers to", found, "copy them with the file")
    if not array.is_virtual and array.id.get_storage_size() == 0:
        raise InputError("frame", "data", f"none in {path.name}", "copy the file again")
    return array.chunks is not None and array.id.get_num_chunks() < prod(
        -(-side // chunk) for side, chunk in zip(array.shape, array.chunks, strict=True)
    )


def _require(package: str, file: Path) -> Any:
    try:
        return import_module(package)
    except ImportError:
        name = package.split(".")[0]
        found = f"no package {name}, which reads {file.name}"
        raise InputError("frame", "a file that can be read", found, f"pip install {name}, or correlograph[files]") from None
