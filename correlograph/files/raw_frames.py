"""Raw frames of a camera: pixels without a header, described by a JSON file beside them.

`run.raw` needs `run.raw.json` or `run.json` with `width`, `height`, `pixel_format`, and optionally `header_bytes`, which are skipped
before each frame.
Pixel formats have their GenICam names (EMVA, Pixel Format Naming Convention 2.4).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from correlograph.errors import InputError
from correlograph.ranges import Range

_SIDE = Range(1, 2**20)
_HEADER = Range(0, 2**30)
MAX_SIDECAR_BYTES = 2**20

RAW_KIND = ".raw"


def _unpack_bits(packed: np.ndarray, bits: int) -> np.ndarray:
    """Return unsigned integers of `bits` bits each from packed bytes, least significant bit first (formats ending in p)."""
    stream = np.unpackbits(packed, bitorder="little")
    places = stream[: len(stream) // bits * bits].reshape(-1, bits)
    return places @ (1 << np.arange(bits, dtype=np.uint16))


def _unpack_gige(packed: np.ndarray, bits: int) -> np.ndarray:
    """Return pairs of pixels from three bytes; the middle one holds the low bits of both (GigE Vision, formats ending in Packed)."""
    first, middle, second = packed.reshape(-1, 3).astype(np.uint16).T
    low = bits - 8
    mask = (1 << low) - 1
    return np.stack([first << low | middle & mask, second << low | middle >> 4 & mask], 1).ravel()


def _words(packed: np.ndarray, bits: int) -> np.ndarray:
    return packed.view("<u2") if bits > 8 else packed


_FORMATS: dict[str, tuple[int, float, Callable[[np.ndarray, int], np.ndarray]]] = {
    "Mono8": (8, 1.0, _words),
    "Mono10": (10, 2.0, _words),
    "Mono12": (12, 2.0, _words),
    "Mono14": (14, 2.0, _words),
    "Mono16": (16, 2.0, _words),
    "Mono10p": (10, 1.25, _unpack_bits),
    "Mono12p": (12, 1.5, _unpack_bits),
    "Mono10Packed": (10, 1.5, _unpack_gige),
    "Mono12Packed": (12, 1.5, _unpack_gige),
}
"""Bits, bytes per pixel and decoder of each format."""


class RawFrames:
    """Frames of a raw file as an array (frames, height, width), read one by one."""

    def __init__(self, file: Path) -> None:
        """Raise InputError for a missing or unsuitable description, and for a file of another size."""
        self._file = file
        described = read_description(file)
        height, width = (_SIDE.check(f"{name} ({file.name})", described.get(name)) for name in ("height", "width"))
        name = described.get("pixel_format")
        if not isinstance(name, str) or name not in _FORMATS:
            expected = f"one of {', '.join(_FORMATS)}"
            raise InputError(f"pixel_format ({file.name})", expected, f"{name!r:.40}", "correct the JSON file beside it")
        self._bits, each, self._decode = _FORMATS[name]
        self._header = _HEADER.check(f"header_bytes ({file.name})", described.get("header_bytes", 0))
        size = height * width * each
        frames, rest = divmod(file.stat().st_size, size + self._header)
        if rest or not frames or not size.is_integer():
            expected = f"a multiple of {size + self._header:g} bytes ({width} x {height} {name})"
            raise InputError("frame", expected, f"{file.stat().st_size} in {file.name}", "correct the JSON file beside it")
        self._size, self.shape = int(size), (int(frames), height, width)

    def __getitem__(self, place: tuple[int, ...]) -> np.ndarray:
        start = place[0] * (self._size + self._header) + self._header
        pixels = self._decode(np.fromfile(self._file, np.uint8, self._size, offset=start), self._bits).reshape(self.shape[1:])
        if int(pixels.max()) >> self._bits:
            expected, found = f"pixels below {1 << self._bits}", f"{pixels.max()} in frame {place[0]} of {self._file.name}"
            raise InputError("frame", expected, found, "correct pixel_format in the JSON file beside it")
        return pixels


def description_of(file: Path) -> Path | None:
    """Return the JSON file that describes a raw file; None without one, and for other kinds of file."""
    beside = (file.with_name(f"{file.name}.json"), file.with_suffix(".json"))
    return next((path for path in beside if path.is_file()), None) if file.suffix.lower() == RAW_KIND else None


def read_description(file: Path) -> dict[str, object]:
    description = description_of(file)
    if description is None:
        remedy = 'write {"width": W, "height": H, "pixel_format": "Mono12p"} into it'
        raise InputError("frame", f"{file.name}.json, which describes {file.name}", "no such file", remedy)
    try:
        content = json.loads(description.read_bytes()[:MAX_SIDECAR_BYTES])
    except (OSError, ValueError, RecursionError) as problem:
        raise InputError("frame", f"JSON in {description.name}", type(problem).__name__, "write valid JSON into it") from None
    if not isinstance(content, dict):
        raise InputError("frame", f"an object in {description.name}", f"{content!r:.40}", "put the description in braces")
    return content
