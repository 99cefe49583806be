"""Monochrome pictures and arrays of any kind: frames, dark frames, truths, published autocorrelations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from correlograph.errors import InputError
from correlograph.files.decoding import decoding
from correlograph.files.exr_frames import FrameHeader, read_frame
from correlograph.lags import LAG_SIDE

MAX_PIXEL = 1e9
"""Beyond any camera's numbers, and safe to square and sum in single precision."""

MAX_PIXELS = 2**29
"""Maximum number of pixels of a frame, 2 GB in single precision; no camera has more."""

PNG_DEPTH_OFFSET = 24
"""Place of the number of bits of each channel in a PNG file. Pillow keeps 16 bits of a single grey channel only."""

FRAME_KINDS = {
    ".exr": "EXR",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".npy": "NPY",
    ".npz": "NPZ",
    ".h5": "HDF5",
    ".hdf5": "HDF5",
    ".hdf": "HDF5",
    ".nxs": "NeXus",
    ".fits": "FITS",
    ".fit": "FITS",
    ".fts": "FITS",
    ".raw": "raw",
    ".zarr": "Zarr",
}
"""File type of a frame by the ending of its name."""


def read_image(file: Path, *, booleans: bool = False) -> tuple[np.ndarray, FrameHeader | None]:
    """Read one monochrome image as float32 (H, W), with its header if it is a frame of the simulator.

    Args:
        booleans: whether the image may consist of true and false, as a mask does.
    """
    pixels, header = _read_pixels(file)
    return as_frame(pixels, file, booleans=booleans), header


def as_frame(pixels: np.ndarray, file: Path, *, booleans: bool = False) -> np.ndarray:
    """Return the pixels of a file as float32 (H, W). Raises InputError for other shapes, types and sizes."""
    if pixels.ndim != 2:
        raise InputError(
            "frame",
            "a monochrome picture (height, width)",
            f"{file.name} of shape {pixels.shape}",
            "give one channel of intensity, one frame a file",
        )
    if pixels.dtype == np.float16:
        pixels = pixels.astype(np.float32)
    if pixels.dtype.kind not in "uifb":
        raise InputError("frame", "numbers", f"{file.name} of type {pixels.dtype}", "convert it to 16-bit integers or floats")
    if not booleans and pixels.dtype.kind == "b":
        raise InputError("frame", "numbers", f"true and false in {file.name}", "convert it to 16-bit integers or floats")
    if (pixels.dtype.kind == "f" or pixels.dtype.itemsize > 2) and not (
        np.abs(np.nan_to_num(pixels, posinf=0.0, neginf=0.0)) <= MAX_PIXEL
    ).all():
        raise InputError("frame", f"pixels up to {MAX_PIXEL:g}", f"larger ones in {file.name}", "scale the frames down")
    return pixels.astype(np.float32)


def _read_pixels(file: Path) -> tuple[np.ndarray, FrameHeader | None]:
    kind = file.suffix.lower()
    if kind == ".exr":
        return read_frame(file)
    with decoding(file):
        if kind == ".npy":
            pixels = np.load(file, allow_pickle=False, mmap_mode="r")
            if not isinstance(pixels, np.ndarray):
                raise InputError("frame", "one array", f"an archive of several in {file.name}", "save it as .npy")
            _check_pixels(pixels.size, file)
            return np.array(pixels), None
        if kind in (".png", ".jpg", ".jpeg"):
            return one_of_equal_channels(_read_picture(file)), None
        if kind in (".tif", ".tiff"):
            return one_of_equal_channels(_read_tiff(file)), None
    raise InputError("picture", "an EXR, TIFF, PNG, JPEG or NPY file", file.name, "convert it")


def one_of_equal_channels(pixels: np.ndarray) -> np.ndarray:
    """Return the first channel of a picture (rows, columns, 3 or 4) whose colour channels are equal, as programs write monochrome frames,
    and whose alpha channel, if any, is constant and not zero; any other array unchanged.
    """
    if pixels.ndim != 3 or pixels.shape[-1] not in (3, 4):
        return pixels
    grey, alpha = pixels[..., 0], pixels[..., 3:]
    is_opaque = (alpha == alpha[:1, :1]).all() and (alpha > 0).all()
    return grey if is_opaque and (pixels[..., :3] == grey[..., None]).all() else pixels


def _read_picture(file: Path) -> np.ndarray:
    from PIL import Image
    from skimage import io

    wanted = FRAME_KINDS[file.suffix.lower()]
    with Image.open(file) as picture:
        if picture.format != wanted:
            raise InputError("frame", f"a {wanted} file", f"{picture.format} in {file.name}", "correct the ending of its name")
        _check_pixels(picture.width * picture.height, file)
        if wanted == "JPEG":
            return np.array(picture)  # decodes the whole file; a truncated one raises OSError
        with file.open("rb") as opened:
            depth = opened.read(PNG_DEPTH_OFFSET + 1)[-1]
        if depth > 8 and not picture.mode.startswith("I"):
            found = f"{len(picture.getbands())} channels of {depth} bits in {file.name}"
            raise InputError("frame", "one channel, or channels of 8 bits", found, "write it as a monochrome PNG or TIFF file")
        picture.verify()  # checks all checksums and the end of the file; reading alone accepts truncated files
    return io.imread(file)


def _read_tiff(file: Path) -> np.ndarray:
    """Read the only page of a TIFF file."""
    import tifffile

    with tifffile.TiffFile(file) as tiff:
        if len(tiff.pages) > 1:
            raise InputError("frame", "one frame", f"{len(tiff.pages)} in {file.name}", "divide the file")
        check_tiff_page(tiff.pages.first, file)
        return decode_tiff_page(tiff.pages.first, file)


def check_tiff_page(page: Any, file: Path) -> None:
    """Refuse pages that are inverted, turned or too large."""
    import tifffile

    if page.photometric not in (None, tifffile.PHOTOMETRIC.MINISBLACK) and page.samplesperpixel == 1:
        found = f"{page.photometric.name} in {file.name}"
        raise InputError("frame", "a TIFF file in which larger numbers are brighter (MINISBLACK)", found, "convert it")
    if page.tags.valueof("Orientation", 1) != 1:
        raise InputError("frame", "an upright TIFF file (orientation 1)", f"a turned one {file.name}", "convert it")
    _check_pixels(page.imagelength * page.imagewidth, file)


def decode_tiff_page(page: Any, file: Path) -> np.ndarray:
    """Decode a page by tifffile, or by Pillow for compressions that tifffile does not decode itself."""
    from PIL import Image

    try:
        return page.asarray()
    except Exception as undecoded:  # every codec raises its own exceptions
        try:
            with Image.open(file) as picture:
                picture.seek(page.index)
                return np.asarray(picture)
        except (OSError, EOFError):
            found = f"{file} ({type(undecoded).__name__}: {undecoded!s:.80})"
            remedy = "write it again uncompressed, or install imagecodecs"
            raise InputError("frame", "a TIFF file that tifffile or Pillow can decode", found, remedy) from None


def _check_pixels(count: int, file: Path) -> None:
    if count > MAX_PIXELS:
        raise InputError("frame", f"at most {MAX_PIXELS:.3g} pixels", f"{count:.3g} in {file.name}", "crop it")


def read_autocorrelation(file: Path) -> tuple[np.ndarray, float]:
    """Read a published autocorrelation image or array: float32 (127, 127), and its quantisation step.

    A 127 x 254 image is read as its left half. Raises InputError for anything else.
    """
    if not file.is_file():
        found = "a folder" if file.is_dir() else "no"
        raise InputError("autocorrelation", "a picture or array", f"{found} {file}", "check the path")
    pixels, _ = read_image(file)
    if pixels.shape == (LAG_SIDE, 2 * LAG_SIDE):
        pixels = pixels[:, :LAG_SIDE]
    if pixels.shape != (LAG_SIDE, LAG_SIDE):
        raise InputError(
            "autocorrelation",
            f"{LAG_SIDE} x {LAG_SIDE} lags (or {LAG_SIDE} x {2 * LAG_SIDE}, left half)",
            f"{pixels.shape[0]} x {pixels.shape[1]} in {file.name}",
            "crop it, zero lag in the middle",
        )
    if not np.isfinite(pixels).all() or (pixels < 0.0).any():
        raise InputError("autocorrelation", "finite lags, zero or more", f"others in {file.name}", "edit the file")
    step = 0.0 if file.suffix.lower() in (".npy", ".exr") else 1.0
    check_symmetry(pixels, file.name, step)
    return pixels, step


def check_symmetry(lags: np.ndarray, name: str, step: float = 0.0) -> None:
    """Refuse lags whose opposite values differ by more than the sum of the quantisation step and 0.1 % of the maximum."""
    asymmetry = np.abs(lags - lags[::-1, ::-1]).max()
    if asymmetry > step + 1e-3 * lags.max():
        raise InputError(
            "autocorrelation",
            "a centro-symmetric picture, zero lag in the middle",
            f"a difference of {asymmetry:g} between opposite lags in {name}",
            "check what the file holds",
        )
