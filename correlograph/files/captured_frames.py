"""Reading and validation of user input: rendered frames, captured frames."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.capture_folder import check_complete
from correlograph.files.exr_frames import FrameHeader
from correlograph.files.file_frames import FileFrames, frame_digest
from correlograph.files.file_metadata import FileMetadata, read_metadata, rendered_metadata
from correlograph.files.images import FRAME_KINDS, MAX_PIXEL, read_image
from correlograph.files.manifest import is_own
from correlograph.files.stacks import file_of, is_stack, open_stack
from correlograph.lags import LAG_SIDE

MIN_PIXEL = 1e-9
"""Minimum of the brightest pixel; squares and sums keep their digits in single precision above it."""

RESULT_NAMES = {
    *("albedo.npy", "albedo.png", "albedo_coarse.npy", "autocorrelation.npy", "deviation.npy", "fields.npz"),
    *("report.png", "plan.png", "samples.npy", "truth.npy", "truth_frames.npy"),
    *("track.png", "rotation.png", "film.npy", "film.png"),
}
"""Names of output files of this program; they are not read as frames."""

MIN_MEAN = -0.25
"""Minimum mean of a frame over the standard deviation of its pixels; the mean of light is positive."""

MAX_KEPT_BYTES = 2**30
"""Size of the frames up to which they are kept in memory; larger captures are read again when they are needed."""

OTHER_PICTURES = {".bmp", ".gif", ".webp", ".jp2", ".dng"}
"""Suffixes of image files that are not read; a message reports such files in a folder of frames."""

JPEG_SUFFIXES = {suffix for suffix, kind in FRAME_KINDS.items() if kind == "JPEG"}
"""Endings of files that are skipped beside frames of another type, because cameras write previews in them."""

MAX_RECORD_BYTES = 2**22
"""Maximum size of a sim.json whose drawing is read."""

SETTINGS = {"exposure_s", "pixel_pitch_m", "row_pitch_m", "gain_e"}
"""Values of file metadata that all frames of a capture share."""

MAX_DEVIATION = 0.03
"""Largest relative deviation of such a value; some cameras write the exposure that they measured."""

CONTACT_SHEET = "contact_sheet"
"""Prefix of the names of contact sheets."""


def find_frames(inputs: Sequence[str | Path]) -> list[Path]:
    """Return the frame files of the inputs in order; a folder stands for its frames."""
    files: list[Path] = []
    for item in map(Path, inputs):
        if item.is_dir() and not is_stack(item):
            check_complete(item)
            found = frames_inside(item)
            if not found:
                raise InputError(
                    "frames", f"a folder with frames ({', '.join(FRAME_KINDS)})", f"none in {item}", "check the folder"
                )
            files.extend(found)
        elif is_stack(item):
            check_complete(file_of(item).parent)
            files.append(item)
        else:
            raise InputError("frames", "a file or folder", f"no {item}", "check the path")
    return files


def _name_other_pictures(folder: Path, kept: Sequence[Path]) -> None:
    previews = JPEG_SUFFIXES - {path.suffix.lower() for path in kept}
    skipped = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in OTHER_PICTURES | previews)
    if skipped:
        others = f" and {len(skipped) - 1} more" if len(skipped) > 1 else ""
        print(f"skipped {skipped[0]}{others} in {folder}; frames are {', '.join(FRAME_KINDS)}", file=sys.stderr)


def by_number(path: Path) -> list[tuple[str, int]]:
    """Return a key that sorts files by name, with the numbers in it by value: frame_2 is before frame_10."""
    parts = re.split("([0-9]+)", path.name)
    return [
        *((text, int(digits or "0")) for text, digits in zip_longest(parts[::2], parts[1::2], fillvalue="")),
        (path.name, 0),
    ]


def frames_inside(folder: Path) -> list[Path]:
    """Return the frame files of a folder in order of their numbers. Raises InputError for frames of several types, such as TIFF and PNG."""
    files = (path for path in folder.iterdir() if not path.name.startswith(".") and path.suffix.lower() in FRAME_KINDS)
    named = sorted(files, key=by_number)
    if odd := [path for path in named if not is_stack(path)]:
        raise InputError("frames", "files", f"a folder, a pipe or a link that leads nowhere: {odd[0]}", "move it elsewhere")
    inside = [path for path in named if not _is_result(path)]
    types = {FRAME_KINDS[path.suffix.lower()]: path for path in inside}
    if len(types) > 1 and types.pop("JPEG", None):
        inside = [path for path in inside if path.suffix.lower() not in JPEG_SUFFIXES]
    if len(types) > 1:
        found = f"{' and '.join(path.name for path in types.values())} in {folder}"
        raise InputError("frames", "files of one type", found, "name the frames one by one, or move the others")
    return inside


def _is_result(path: Path) -> bool:
    """Return whether a file has the name of an output of this program, and is in its manifest or cannot be a frame."""
    if path.name not in RESULT_NAMES and not path.name.startswith(CONTACT_SHEET):
        return False
    if is_own(path):
        return True
    try:
        return min(read_image(path)[0].shape) <= LAG_SIDE
    except InputError:
        return True


def read_capture(inputs: Sequence[str | Path], known: CameraMetadata) -> Capture:
    """Read all frames as one capture; options (`known`) override file headers.

    Raises InputError for damaged, coloured, constant, non-finite or differently sized frames, for contradictory headers, and for a frame
    that is given twice.
    """
    files = find_frames(inputs)
    for folder in (path for path in map(Path, inputs) if path.is_dir() and not is_stack(path)):
        _name_other_pictures(folder, files)
    frames = FileFrames([open_stack(file) for file in files], _CaptureCheck())
    pixels, first = frames.read(0)
    given = {name: value for name, value in vars(known).items() if value is not None}
    if "pixel_pitch_m" in given:  # the angles of the header belong to its own pitch
        given = {"row_pitch_m": None, "column_pitch_m": None, **given}
    written = _common_metadata(files) if first is None else rendered_metadata(first.exposure_s)
    if {"wavelength_m", "distance_m"} <= given.keys() and written.pixel_pitch_m is not None:
        by_file = {"pixel_pitch_m": written.pixel_pitch_m}
        if written.row_pitch_m is not None:
            by_file |= {"row_pitch_m": written.row_pitch_m, "column_pitch_m": written.pixel_pitch_m}
        given = {**by_file, **given}
    metadata = replace(CameraMetadata.of(first), **given)
    kept = list(frames) if len(frames) * pixels.nbytes <= MAX_KEPT_BYTES else frames
    names = tuple(printable(file.name) for file in files)
    return Capture(kept, metadata, names, record=_read_drawing(files[0], first), file_metadata=written)


def _common_metadata(files: Sequence[Path]) -> FileMetadata:
    """Return the metadata of the first file, with settings that only later ones state. Raises InputError for settings that differ."""
    every, stated = [read_metadata(file) for file in files], {}
    for file, written in zip(files, every, strict=True):
        values = written.as_dict()
        if written.pixel_pitch_m is not None:  # pixels are square unless the file says otherwise
            values.setdefault("row_pitch_m", written.pixel_pitch_m)
        for name in SETTINGS & values.keys():
            value = values[name]
            expected, where = stated.setdefault(name, (value, file))
            if not math.isclose(value, expected, rel_tol=MAX_DEVIATION):
                raise InputError(
                    "frames",
                    f"frames of one camera setting ({name} {expected:.4g}, as {where.name})",
                    f"{value:.4g} in {file.name}",
                    "invert the captures one by one",
                )
    known = {name: value for name, (value, _) in stated.items() if name != "row_pitch_m" or value != stated["pixel_pitch_m"][0]}
    return replace(every[0], **known)


def describe_files(capture: Capture) -> list[str]:
    """Return notes on the first file of a capture: a pixel pitch from its metadata, equal colour channels, lossy compression."""
    written, name = capture.file_metadata, capture.names[0] if capture.names else ""
    notes = []
    if written.pixel_pitch_m is not None and capture.camera.pixel_pitch_m == written.pixel_pitch_m:
        rows = "" if written.row_pitch_m is None else f" (rows: {written.row_pitch_m * 1e6:.4g} um)"
        notes.append(f"the pixel pitch of {written.pixel_pitch_m * 1e6:.4g} um{rows} comes from the metadata of {name}")
    if written.channels is not None:
        notes.append(f"the {written.channels} channels of {name} are equal; one is used")
    if Path(name).suffix.lower() in JPEG_SUFFIXES:
        notes.append(
            f"{name} is a JPEG file, whose compression and tone curve change the noise and the contrast; record TIFF or PNG"
        )
    return notes


def stray_light_of(capture: Capture) -> list[str]:
    """Return what the plan of rendered frames says of stray light, which an estimate cannot tell from the object's."""
    warnings = (capture.plan or {}).get("warnings", [])
    return [f"sim.json: {warning}" for warning in warnings if str(warning).startswith("other_light: stray light")]


class _CaptureCheck:
    """Refuses frames that differ from the first one in size or header, and copies of earlier frames."""

    def __init__(self) -> None:
        self._first: tuple[tuple[int, ...], FrameHeader | None, Path] | None = None
        self._places: dict[bytes, tuple[int, Path]] = {}

    def __call__(self, pixels: np.ndarray, header: FrameHeader | None, number: int, file: Path) -> None:
        check_frame(pixels, file)
        shape, first, first_file = self._first = self._first or (pixels.shape, header, file)
        if pixels.shape != shape:
            raise InputError(
                "frames",
                f"frames of one size ({shape[1]} x {shape[0]}, as {first_file.name})",
                f"{pixels.shape[1]} x {pixels.shape[0]} in {file.name}",
                "give frames of one camera setting",
            )
        if pixels.any():
            self._add(frame_digest(pixels), number, file)
        if _capture_of(header) != _capture_of(first):
            raise InputError(
                "frames",
                "frames of one capture (same scene, exposure, wavelength, pitch and distance)",
                f"another header in {file.name}",
                "invert the captures one by one",
            )

    def merge(self, other: _CaptureCheck) -> None:
        """Add the frames that a copy of this check has seen."""
        for digest, (number, file) in other._places.items():
            self._add(digest, number, file)

    def _add(self, digest: bytes, number: int, file: Path) -> None:
        """Raise InputError if a frame of another number has the same digest."""
        if self._places.setdefault(digest, (number, file))[0] != number:
            raise InputError("frames", "independent frames", f"{file.name} repeats an earlier frame", "leave the copy out")


def _read_drawing(file: Path, header: FrameHeader | None) -> dict[str, Any]:
    """Return the drawing of the scene in the sim.json beside a rendered frame, if it is that of the same scene."""
    path = file.with_name("sim.json")
    if header is None or not path.is_file() or path.stat().st_size > MAX_RECORD_BYTES:
        return {}
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError):
        return {}
    is_same = isinstance(content, dict) and content.get("scene_sha256") == header.scene_sha256
    return {"drawing": content["drawing"]} if is_same and "drawing" in content else {}


def printable(name: str) -> str:
    """Return the name of a file with question marks for bytes that are not UTF-8."""
    return name.encode("utf-8", "replace").decode()


def check_frames_in_memory(frames: Sequence[np.ndarray], check: Callable[[np.ndarray, Path], object] | None = None) -> None:
    """Raise InputError for a frame that fails a check, `check_frame` by default; those of files are checked when they are read."""
    for number, frame in enumerate(() if isinstance(frames, FileFrames) else frames):
        (check or check_frame)(np.asarray(frame), Path(f"frame {number}"))


def check_copies(frames: Iterable[np.ndarray]) -> None:
    """Raise InputError if a frame, or its spectrum, is the same as an earlier one, as of a camera that stalls; frames of zeros may be."""
    alike: dict[bytes, list[tuple[int, np.ndarray]]] = {}
    for number, one in enumerate(frames):
        others = alike.setdefault(frame_digest(one.real), [])
        before = next((earlier for earlier, other in others if np.array_equal(one, other) and np.any(one)), None)
        if before is not None:
            found = f"frame {number} is a copy of frame {before}"
            raise InputError("frames", "frames of different times", found, "leave the copies out")
        others.append((number, one))


def check_range(pixels: np.ndarray, file: Path) -> tuple[float, float]:
    """Return the lowest and the highest pixel. Raises InputError for NaN, infinity, and values whose squares single precision does not
    hold."""
    lowest, highest = (float(pixels.min()), float(pixels.max())) if pixels.size else (0.0, 0.0)
    if not (math.isfinite(lowest) and math.isfinite(highest)):  # NaN anywhere makes both NaN
        raise InputError("frame", "finite pixels", f"NaN or infinity in {file.name}", "leave the frame out")
    largest = max(abs(lowest), abs(highest))
    if largest > MAX_PIXEL or 0.0 < largest < MIN_PIXEL:
        raise InputError(
            "frame",
            f"pixels whose largest lies between {MIN_PIXEL:g} and {MAX_PIXEL:g}",
            f"{largest:.3g} in {file.name}",
            "scale the frames",
        )
    return lowest, highest


def check_frame(pixels: np.ndarray, file: Path) -> None:
    """Refuse frames that cannot be speckle. Frames of zeros are legal, because a short exposure may be empty."""
    lowest, highest = check_range(pixels, file)
    if pixels.shape in ((LAG_SIDE, LAG_SIDE), (LAG_SIDE, 2 * LAG_SIDE)):
        raise InputError("frame", "speckle", f"{file.name}, as large as a published autocorrelation", "add --autocorrelation")
    if lowest == highest != 0.0:
        raise InputError(
            "frame",
            "speckle",
            f"the same value {lowest:g} everywhere in {file.name}",
            "check the exposure or leave the frame out",
        )
    # Raw frames have no negative pixels, and are not summed up.
    if lowest < 0.0 and (mean := float(pixels.mean(dtype=np.float64))) < MIN_MEAN * float(pixels.std(dtype=np.float64)):
        raise InputError(
            "frame",
            "a positive mean",
            f"{mean:.3g} in {file.name}",
            "subtract the offset of the camera once only, or give raw frames",
        )
    if min(pixels.shape) < LAG_SIDE:
        raise InputError(
            "frame",
            f"at least {LAG_SIDE} x {LAG_SIDE} pixels",
            f"{pixels.shape[1]} x {pixels.shape[0]} in {file.name}",
            "give larger frames",
        )


def _capture_of(header: FrameHeader | None) -> FrameHeader | None:
    """Return the part of a header that all frames of a capture share."""
    return header and replace(header, seed=0, frame=0)
