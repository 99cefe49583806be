"""Version of the installed package."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed


def version() -> str:
    """Return the version that `pip` reports; `uninstalled` for a bare checkout."""
    try:
        return installed("correlograph")
    except PackageNotFoundError:
        return "uninstalled"
