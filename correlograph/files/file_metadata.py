"""Metadata that cameras and their programs write into files of frames."""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from correlograph.files.raw_frames import RAW_KIND, read_description
from correlograph.files.stacks import FITS_KINDS, HDF5_KINDS, file_of

MAX_XML_CHARACTERS = 2**22
"""Maximum length of an OME description that is parsed."""

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "nm": 1e-9}
_EXPOSURES = ("count_time", "exposure_time", "exposuretime", "exposure")
_MICRO_MANAGER_TAG = 51123


@dataclass(frozen=True)
class FileMetadata:
    """Metadata of the first frame of a file; None for values that the file does not hold.

    Attributes:
        exposure_s: exposure time.
        pixel_pitch_m: width of a pixel on the photographed wall, as OME and Micro-Manager files state it for the specimen.
        row_pitch_m: height of a pixel, if it differs.
        gain_e: photoelectrons per count.
        bits: significant bits of a pixel.
        time: date and time of the first frame, as the file writes them.
        channels: number of colour channels of a picture, None for a monochrome one.
    """

    exposure_s: float | None = None
    pixel_pitch_m: float | None = None
    gain_e: float | None = None
    bits: int | None = None
    time: str | None = None
    channels: int | None = None
    row_pitch_m: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the known values, for JSON."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def rendered_metadata(exposure_s: float) -> FileMetadata:
    """Return the metadata of rendered frames, whose unit is the photoelectron."""
    return FileMetadata(exposure_s=float(np.float32(exposure_s)), gain_e=1.0)


def read_metadata(path: Path) -> FileMetadata:
    """Read the metadata of a file that holds frames. Damaged metadata count as missing."""
    file = file_of(path)
    kind = file.suffix.lower()
    try:
        if kind in (".tif", ".tiff"):
            return _read_tiff(file)
        if kind in (".png", ".jpg", ".jpeg"):
            return FileMetadata(channels=_channels_of(file))
        if kind in FITS_KINDS:
            return _read_fits(file)
        if kind in HDF5_KINDS:
            return _read_hdf5(file)
        if kind == RAW_KIND:
            described = read_description(file)
            return _metadata(*map(described.get, ("exposure_s", "pixel_pitch_m", "gain_e", "bits", "time")))
    except Exception:  # every decoder raises its own exceptions; the frames themselves can be read
        return FileMetadata()
    return FileMetadata()


def _metadata(exposure: Any = None, pitch: Any = None, gain: Any = None, bits: Any = None, time: Any = None) -> FileMetadata:
    """Return the metadata of values that may be missing or impossible."""
    depth = _positive(bits)
    return FileMetadata(
        _positive(exposure), _positive(pitch), _positive(gain), None if depth is None else int(depth), _text(time)
    )


def _text(value: Any) -> str | None:
    """Return at most 40 characters of a text, None for anything else."""
    return value[:40] if isinstance(value, str) and value else None


def _unit_of(units: Mapping[str, float], name: Any) -> float:
    """Return a unit in SI units, NaN for an unknown one."""
    return units.get(name, math.nan) if isinstance(name, str) else math.nan


def _positive(value: Any, unit: float = 1.0) -> float | None:
    """Return a positive number in SI units, None for anything else."""
    try:
        number = math.nan if isinstance(value, bool) else float(value) * unit
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) and number > 0.0 else None


def _read_tiff(file: Path) -> FileMetadata:
    import tifffile

    with tifffile.TiffFile(file) as tiff:
        samples = int(tiff.pages.first.samplesperpixel)
        channels = samples if samples > 1 else None
        if tiff.ome_metadata and len(tiff.ome_metadata) <= MAX_XML_CHARACTERS:
            return replace(_read_ome(ElementTree.fromstring(tiff.ome_metadata)), channels=channels)
        tag = tiff.pages.first.tags.get(_MICRO_MANAGER_TAG)
        if tag is not None and isinstance(tag.value, Mapping):
            page = tag.value
            return _metadata(
                _positive(page.get("Exposure-ms"), 1e-3),
                _positive(page.get("PixelSizeUm"), 1e-6),
                bits=page.get("BitDepth"),
                time=page.get("ReceivedTime") or page.get("Time"),
            )
    return FileMetadata(channels=channels)


def _channels_of(file: Path) -> int | None:
    from PIL import Image

    with Image.open(file) as picture:
        count = len(picture.getbands())
    return count if count > 2 else None


def _read_ome(root: ElementTree.Element) -> FileMetadata:
    pixels, plane, acquired = root.find(".//{*}Pixels"), root.find(".//{*}Plane"), root.find(".//{*}AcquisitionDate")
    exposure = pitch = height = bits = None
    if pixels is not None:
        bits = pixels.get("SignificantBits")
        pitch, height = (
            _positive(pixels.get(f"PhysicalSize{axis}"), _unit_of(_METRES, pixels.get(f"PhysicalSize{axis}Unit", "µm")))
            for axis in "XY"
        )
    if plane is not None:
        exposure = _positive(plane.get("ExposureTime"), _unit_of(_SECONDS, plane.get("ExposureTimeUnit", "s")))
    found = _metadata(exposure, pitch, bits=bits, time=None if acquired is None else acquired.text)
    return found if pitch is None or height == pitch else replace(found, row_pitch_m=height)


def _read_fits(file: Path) -> FileMetadata:
    from astropy.io import fits

    with fits.open(file) as units:
        of_image = next(unit.header for unit in units if unit.is_image and len(unit.shape) > 1)
        header = ChainMap(of_image, units[0].header)  # an extension may leave its camera to the first header
        exposure = _positive(header.get("EXPTIME")) or header.get("EXPOSURE")
        return _metadata(exposure, gain=header.get("EGAIN"), time=header.get("DATE-OBS"))


def _read_hdf5(file: Path) -> FileMetadata:
    import h5py

    found: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        last = name.rsplit("/", 1)[-1].lower()
        if not isinstance(item, h5py.Dataset) or item.size != 1:
            return
        value = item.asstr()[()] if h5py.check_string_dtype(item.dtype) else item[()].item()
        if last in _EXPOSURES:
            unit = item.attrs.get("units", "s")
            found.setdefault("exposure", _positive(value, _unit_of(_SECONDS, unit)))
        elif last == "start_time":
            found.setdefault("time", value)

    with h5py.File(file, "r") as opened:
        opened.visititems(visit)
    return _metadata(**found)
