"""The EXR header attribute `version`, which the OpenEXR binding (3.5) neither writes nor reads.

The frame format of this project requires the name, and OpenEXR allows it, so it is written into and read from the bytes of
the header. Layout: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

_FIRST_ATTRIBUTE = 8  # after the magic number and the format's version field


def _attributes(content: bytes) -> Iterator[tuple[int, str, bytes]]:
    """Yield (offset of the end, name, value) of each attribute of a single-part header."""
    place = _FIRST_ATTRIBUTE
    while content[place]:
        name_end = content.index(b"\0", place)
        type_end = content.index(b"\0", name_end + 1)
        size = struct.unpack_from("<i", content, type_end + 1)[0]
        value = content[type_end + 5 : type_end + 5 + size]
        name = content[place:name_end].decode()
        place = type_end + 5 + size
        yield place, name, value


def add_version(content: bytes, version: str, blocks: int) -> bytes:
    """Add `version` to a single-part scan-line file whose offset table has `blocks` entries."""
    end = max(place for place, _, _ in _attributes(content))
    attribute = b"version\0string\0" + struct.pack("<i", len(version)) + version.encode()
    table = struct.Struct(f"<{blocks}Q")
    offsets = [offset + len(attribute) for offset in table.unpack_from(content, end + 1)]
    rest = content[end + 1 + table.size :]
    return content[:end] + attribute + b"\0" + table.pack(*offsets) + rest


def read_version(path: Path) -> str | None:
    """Return the attribute `version` of a file, None without one."""
    try:
        return next((value.decode() for _, name, value in _attributes(path.read_bytes()) if name == "version"), None)
    except (IndexError, ValueError, struct.error):  # not a single-part file; the library reports what it is
        return None
