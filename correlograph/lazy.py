"""Public names that are imported when they are first used."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from correlograph.errors import missing_package


def load_attribute(package: str, modules: Mapping[str, str], name: str) -> Any:
    """Import a public name of a package from its module. Raises AttributeError for another name, and InputError if an optional
    package is missing.
    """
    if name not in modules:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    try:
        value = getattr(import_module(modules[name]), name)
    except ModuleNotFoundError as error:
        raise missing_package(error) from None
    setattr(sys.modules[package], name, value)
    return value
