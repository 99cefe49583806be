"""Version of the installed package, and digest of its code."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed
from pathlib import Path

ROOT = Path(__file__).parents[1]
"""Folder of the packages."""

PACKAGES = ("correlograph", "invert", "radiometry")
"""Packages on which a reconstruction depends."""


def version() -> str:
    """Return the version that `pip` reports; `uninstalled` for a bare checkout."""
    try:
        return installed("correlograph")
    except PackageNotFoundError:
        return "uninstalled"


@cache
def code_sha256(root: Path = ROOT) -> str:
    """Return the SHA-256 of the code and weights that a reconstruction depends on: results of others are not taken for those of these."""
    content = hashlib.sha256()
    for file in sorted(
        file for package in PACKAGES for kind in ("*.py", "*.safetensors") for file in (root / package).rglob(kind)
    ):
        content.update(file.relative_to(root).as_posix().encode() + file.read_bytes())
    return content.hexdigest()
