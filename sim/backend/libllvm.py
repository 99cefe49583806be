"""Selection of the libLLVM that Dr.Jit loads: the newest one, unless DRJIT_LIBLLVM_PATH names another."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager

NAME = "DRJIT_LIBLLVM_PATH"
"""Environment variable that selects a libLLVM."""

MIN_LLVM_VERSION = 17
"""Oldest libLLVM that compiles min and max of Dr.Jit on x86, which spheres, smooth meshes, masks and microfacets use."""

_PLACES = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm/lib/libLLVM*.dylib",
)


def version_of(path: str) -> int | None:
    """Return the major version in the name of a library, after following links; None if the name has no version."""
    for name in (os.path.basename(path), os.path.basename(os.path.realpath(path)), os.path.realpath(path)):
        found = re.search(r"libLLVM[-.](?:so\.)?(\d+)|llvm[-@](\d+)", name)
        if found:
            return int(found.group(1) or found.group(2))
    return None


def newest() -> tuple[str, int] | None:
    """Return path and major version of the newest installed libLLVM; None without any."""
    found = [(version_of(path), path) for place in _PLACES for path in glob.glob(place) if os.path.isfile(path)]
    versions = sorted((version, path) for version, path in found if version is not None)
    return (versions[-1][1], versions[-1][0]) if versions else None


@contextmanager
def newest_preferred() -> Iterator[None]:
    """Let Dr.Jit load the newest libLLVM within a `with` block; the environment is unchanged afterwards."""
    best = newest()
    if NAME in os.environ or best is None or best[1] < MIN_LLVM_VERSION:
        yield
        return
    os.environ[NAME] = best[0]
    try:
        yield
    finally:
        del os.environ[NAME]
