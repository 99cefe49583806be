"""Speckle frames as EXR files: one float32 channel `photoelectrons` and the metadata of the capture."""

from __future__ import annotations

import io
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.errors import InputError, check_positive, missing_package
from correlograph.files.exr_version import add_version, read_version
from correlograph.files.output import atomic, silence_output

CHANNEL = "photoelectrons"

_LINES_PER_BLOCK = 16  # of ZIP compression


@dataclass(frozen=True)
class FrameHeader:
    """Attributes of a frame file; None for attributes that other software may omit.

    Lengths in metres. `pixel_pitch_m` holds for a wall that faces the camera, `distance_m` is from object to virtual
    detector. `row_pitch_m` and `column_pitch_m` are the distances of neighbouring rows and columns of pixels on the virtual
    detector, projected perpendicular to the line of sight from the object.
    """

    wavelength_m: float
    pixel_pitch_m: float
    distance_m: float
    exposure_s: float
    seed: int
    frame: int
    scene_sha256: str
    version: str
    pupil_diameter_m: float | None = None
    pupil_distance_m: float | None = None
    row_pitch_m: float | None = None
    column_pitch_m: float | None = None


def _library() -> Any:
    """Return OpenEXR. Raises InputError if it is not installed."""
    try:
        import OpenEXR
    except ModuleNotFoundError as error:
        raise missing_package(error) from None
    return OpenEXR


def can_write_frames() -> bool:
    """Return whether OpenEXR is installed."""
    try:
        _library()
    except InputError:
        return False
    return True


def write_frame(path: Path, photoelectrons: np.ndarray, header: FrameHeader) -> None:
    """Write a frame (H, W) with its header; the file appears only when it is complete."""
    library = _library()
    attributes: dict[str, Any] = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    attributes.update({name: value for name, value in asdict(header).items() if value is not None and name != "version"})
    pixels = np.ascontiguousarray(photoelectrons, np.float32)
    with atomic(path) as partial:
        stream = io.BytesIO()  # the library refuses names that are not UTF-8
        library.File(attributes, {CHANNEL: pixels}).write(stream)
        partial.write_bytes(add_version(stream.getvalue(), header.version, -(-pixels.shape[0] // _LINES_PER_BLOCK)))


def read_frame(path: Path) -> tuple[np.ndarray, FrameHeader | None]:
    """Read a frame: float32 (H, W), and its header, None where the file contains no metadata.

    Raises InputError for a damaged file or one with colour channels.
    """
    library = _library()
    try:
        with silence_output(), library.File(io.BytesIO(path.read_bytes()), separate_channels=True) as file:
            if len(file.parts) != 1:
                raise ValueError(f"{len(file.parts)} parts instead of one")
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
            attributes = {**file.header(), "version": read_version(path)}
    except Exception as error:  # the library raises bare exceptions of several kinds
        raise InputError(
            "frame",
            "a whole EXR file",
            f"{path} ({str(error).splitlines()[0] if str(error) else 'damaged'})",
            "write it again or leave it out",
        ) from None
    if len(channels) != 1:
        raise InputError(
            "frame",
            f"one channel ({CHANNEL})",
            f"{path} with {', '.join(sorted(channels))}",
            "convert it to one channel of intensity",
        )
    pixels = next(iter(channels.values())).astype(np.float32)
    known = {field.name: attributes[field.name] for field in fields(FrameHeader) if field.name in attributes}
    required = {field.name for field in fields(FrameHeader) if field.default is not None}
    if not required <= set(known):
        return pixels, None
    for name, value in known.items():
        is_text = name in ("scene_sha256", "version")
        if isinstance(value, str) != is_text or (name in ("seed", "frame") and not isinstance(value, int)):
            expected = "text" if is_text else "a number"
            raise InputError("frame", f"{expected} as {name}", f"{value!r:.40} in {path.name}", "render the frame again")
        if name.endswith(("_m", "_s")):
            known[name] = check_positive(f"{name} of {path.name}", value)
    return pixels, FrameHeader(**known)
