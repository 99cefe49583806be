"""Scene files: loading with parameters, checks, and a hash of the file and everything it uses."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import mitsuba as mi

from correlograph.errors import InputError
from sim.plugins import refusals
from sim.variant import check_loadable


def parse_definitions(pairs: list[str]) -> dict[str, str]:
    """`-D key=value` options as a mapping."""
    definitions = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not key or not equals or not value:
            raise InputError("-D", "key=value", pair, "write it as -D exposure=0.125")
        if key in definitions:
            raise InputError(f"-D {key}", "one value", f"both {definitions[key]} and {value}", "give it once")
        definitions[key] = value
    return definitions


def load_scene(path: str | Path, definitions: Mapping[str, str] | None = None) -> tuple[mi.Scene, str]:
    """Load a scene file; returns the scene and the SHA-256 of its XML, assets and definitions.

    A definition that names an existing file is taken relative to the current folder first, then to
    the scene's. Raises InputError for anything that Mitsuba or a plugin refuses.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("scene", "a Mitsuba scene file (XML)", path, "check the path")
    content = path.read_bytes()
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # the latter two for unknown encodings
        raise InputError("scene", "well-formed XML", f"{path} ({error})", "correct the file") from None
    check_loadable(root)
    defaults = {node.get("name", ""): node.get("value", "") for node in root.iter("default")}
    given = dict(definitions or {})
    unknown = sorted(set(given) - set(defaults))
    if unknown:
        raise InputError(
            f"-D {unknown[0]}",
            f"one of the scene's parameters ({', '.join(defaults) or 'none'})",
            unknown[0],
            "correct the name or add a <default> to the scene",
        )
    names = _file_parameters(root, defaults)
    for key in names & set(given):
        if Path(given[key]).is_file():
            given[key] = str(Path(given[key]).resolve())
    effective = {**defaults, **given}
    assets = _assets(root, path.parent, effective, (path.resolve(),))
    refusals.clear()
    try:
        scene = mi.load_file(str(path), optimize=False, **given)
    except Exception as error:  # Mitsuba raises bare exceptions, and wraps those of plugins in its own
        raise refusals[0] if refusals else _as_input_error(error, path) from None
    return scene, _digest(content, assets, {key: value for key, value in effective.items() if key not in names})


def _file_parameters(root: ElementTree.Element, parameters: Mapping[str, str]) -> set[str]:
    """Parameters that stand in file names."""
    texts = [node.get("value", "") for node in root.iter("string") if node.get("name") == "filename"]
    return {key for key in parameters if any(re.search(rf"\${re.escape(key)}\b", text) for text in texts)}


def _assets(root: ElementTree.Element, folder: Path, parameters: Mapping[str, str], parents: tuple[Path, ...]) -> list[Path]:
    """Files that the scene names or includes, and those that these name in turn, parameters filled in."""
    files = []
    for node in root.iter("include"):
        file = _named_file(node.get("filename", ""), folder, parameters)
        if file.resolve() in parents:
            raise InputError("scene", "files that do not include one another in a circle", file, "remove an <include>")
        try:
            included = ElementTree.fromstring(file.read_bytes())
        except (ElementTree.ParseError, LookupError, ValueError) as error:
            raise InputError("scene", "well-formed XML", f"{file} ({error})", "correct the file") from None
        check_loadable(included)
        own = {node.get("name", ""): node.get("value", "") for node in included.iter("default")}
        # Mitsuba looks for files beside the outermost scene.
        files += [file, *_assets(included, folder, {**own, **parameters}, (*parents, file.resolve()))]
    for node in root.iter("string"):
        if node.get("name") == "filename":
            files.append(_named_file(node.get("value", ""), folder, parameters))
    return files


def _named_file(name: str, folder: Path, parameters: Mapping[str, str]) -> Path:
    filled = name
    for key in sorted(parameters, key=len, reverse=True):
        filled = filled.replace(f"${key}", parameters[key])
    file = folder / filled
    if not file.is_file():
        raise InputError("scene", f"the file that {name} stands for", f"no {file}", "check the path")
    return file


def _digest(content: bytes, assets: list[Path], definitions: Mapping[str, str]) -> str:
    """Hash that does not depend on where the files lie, nor on whether a default is spelt out."""
    digest = hashlib.sha256(content)
    for file in assets:
        digest.update(file.read_bytes())
    for key, value in sorted(definitions.items()):
        digest.update(f"\0{key}={value}".encode())
    return digest.hexdigest()


def _as_input_error(error: Exception, path: Path) -> InputError:
    """The telling line of Mitsuba's message."""
    lines = [line.strip(" -") for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if "rror" in line or "expected" in line]
    reason = (telling or lines or [type(error).__name__])[-1]
    return InputError("scene", "a scene that Mitsuba can load", f"{path} ({reason})", "correct the file or the -D values")
