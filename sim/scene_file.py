"""Scene files: loading with parameters, checks, and a digest of the file and all its assets."""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import mitsuba as mi

from correlograph.errors import InputError
from scenes import scene_names, scene_path
from sim.backend.variant import check_loadable
from sim.coloured_bitmaps import check_opaque, describe_colours
from sim.mesh import check_faces
from sim.plugins import refusals
from sim.scene_checks import damaged_mesh

FILE_NAMES = ("filename", "trajectory")
"""Names of the parameters that hold the name of a file."""

SPECTRA = ("irregular", "regular", "blackbody", "d65")
"""Plugins whose values depend on the wavelength."""

MAX_ASSETS = 1000
"""Maximum number of files that a scene names or includes."""


def parse_definitions(pairs: list[str]) -> dict[str, str]:
    """Parse `-D key=value` options into a mapping."""
    definitions = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not key or not equals or not value:
            raise InputError("-D", "key=value", pair, "write it as -D exposure=0.125")
        if key in definitions:
            raise InputError(f"-D {key}", "one value", f"both {definitions[key]} and {value}", "give it once")
        definitions[key] = value
    return definitions


def find_scene(name: str | Path) -> Path:
    """Return the path of a scene file, or of the shipped scene of that name. Raises InputError if there is neither."""
    path = Path(name)
    if path.is_file():
        return path
    if str(name) in scene_names():
        return scene_path(str(name))
    expected = f"a Mitsuba scene file (XML), or one of the shipped scenes {', '.join(scene_names())}"
    raise InputError("scene", expected, name, "check the path or the name")


def load_scene(path: str | Path, definitions: Mapping[str, str] | None = None) -> tuple[mi.Scene, str]:
    """Load a scene file; return the scene and the SHA-256 of its XML, assets and definitions.

    A definition that names an existing file is looked up in the current folder first, then in that of the scene. Raises InputError for
    anything that Mitsuba or a plugin refuses.
    """
    path = find_scene(path)
    given, digest, assets = _inspect(path, definitions or {})
    check_opaque(assets)
    for file in assets:
        if file.suffix.lower() == ".ply":
            check_faces(file)
    refusals.clear()
    try:
        scene = mi.load_file(str(path), optimize=False, **given)
    except Exception as error:  # Mitsuba raises bare exceptions, and wraps those of plugins in its own
        raise refusals[0] if refusals else _as_input_error(error, path) from None
    if damaged := damaged_mesh(scene):
        del scene  # the traceback of the error would keep it
        raise damaged
    for note in describe_colours(assets):
        print(f"note: {note}", file=sys.stderr)
    return scene, digest


def scene_digest(path: str | Path, definitions: Mapping[str, str]) -> str:
    """Return the SHA-256 of a scene file, its assets and definitions. Raises InputError for unknown definitions."""
    return _inspect(find_scene(path), definitions)[1]


def _inspect(path: Path, definitions: Mapping[str, str]) -> tuple[dict[str, str], str, list[Path]]:
    """Check the XML and the definitions; return the definitions with resolved file names, the digest, and the files of the scene."""
    content = path.read_bytes()
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # the latter two for unknown encodings
        raise InputError("scene", "well-formed XML", f"{path} ({error})", "edit the file") from None
    check_loadable(root)
    defaults = {node.get("name", ""): node.get("value", "") for node in root.iter("default")}
    given = dict(definitions)
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
        elif not (path.parent / given[key]).is_file():
            expected = f"a file in the current folder or in {path.parent}"
            raise InputError(f"-D {key}", expected, f"no {given[key]}", "check the path")
    effective = {**defaults, **given}
    _check_spectra(root, effective)
    assets = _assets(root, path.parent, effective, (path.resolve(),))
    digest = _digest(content, assets, {key: value for key, value in effective.items() if key not in names})
    return given, digest, assets


def _file_parameters(root: ElementTree.Element, parameters: Mapping[str, str]) -> set[str]:
    """Return the parameters that occur in file names."""
    texts = [node.get("value", "") for node in root.iter("string") if node.get("name") in FILE_NAMES]
    return {key for key in parameters if any(re.search(rf"\${re.escape(key)}\b", text) for text in texts)}


def _assets(root: ElementTree.Element, folder: Path, parameters: Mapping[str, str], parents: tuple[Path, ...]) -> list[Path]:
    """Return the files that the scene names or includes, and recursively those of the files that it includes, with
    parameters substituted.
    """
    files: list[Path] = []
    folders = [folder, *(folder / node.get("value", "") for node in root.iter("path"))]
    for node in root.iter("include"):
        file = _named_files(node.get("filename", ""), folders, parameters)[0]
        if file.resolve() in parents:
            raise InputError("scene", "files that do not include one another in a circle", file, "remove an <include>")
        try:
            included = ElementTree.fromstring(file.read_bytes())
        except (ElementTree.ParseError, LookupError, ValueError) as error:
            raise InputError("scene", "well-formed XML", f"{file} ({error})", "edit the file") from None
        check_loadable(included)
        own = {node.get("name", ""): node.get("value", "") for node in included.iter("default")}
        _check_spectra(included, {**own, **parameters})
        # Mitsuba resolves files relative to the outermost scene.
        files += [file, *_assets(included, folder, {**own, **parameters}, (*parents, file.resolve()))]
        if len(files) > MAX_ASSETS:
            raise InputError("scene", f"at most {MAX_ASSETS} files", "more by nested includes", "include fewer files")
    for node in root.iter():
        name = node.get("value", "") if node.tag == "string" and node.get("name") in FILE_NAMES else node.get("filename")
        if name is not None and node.tag != "include":
            files += _named_files(name, folders, parameters)
    return files


def _check_spectra(root: ElementTree.Element, parameters: Mapping[str, str]) -> None:
    """Raise InputError for a spectrum, because Mitsuba would take its luminance for the value at the laser's wavelength."""
    for node in (*root.iter("spectrum"), *root.iter("texture")):
        kind, value = (_fill(node.get(name, ""), parameters) for name in ("type", "value"))
        if kind in SPECTRA or ":" in value or (node.tag == "spectrum" and node.get("filename") is not None):
            raise InputError(
                f"spectrum {node.get('name')}",
                "a value at the laser's wavelength",
                value or (node.get("filename") or f"one of type {kind}"),
                f'write <spectrum name="{node.get("name")}" value="..."/> with one number',
            )


def _fill(text: str, parameters: Mapping[str, str]) -> str:
    """Return a text with the values of parameters."""
    for key in sorted(parameters, key=len, reverse=True):
        text = text.replace(f"${key}", parameters[key])
    return text


def _named_files(name: str, folders: Sequence[Path], parameters: Mapping[str, str]) -> list[Path]:
    """Return the files of a name in all folders that Mitsuba searches. Raises InputError if there is none."""
    filled = _fill(name, parameters)
    files = [folder / filled for folder in folders if (folder / filled).is_file()]
    if not files:
        raise InputError("scene", f"the file that {name} stands for", f"no {folders[0] / filled}", "check the path")
    return files


def _digest(content: bytes, assets: list[Path], definitions: Mapping[str, str]) -> str:
    """Return a digest that depends neither on the location of the files nor on whether a default is given explicitly."""
    digest = hashlib.sha256(content)
    for file in assets:
        digest.update(file.read_bytes())
    for key, value in sorted(definitions.items()):
        digest.update(f"\0{key}={value}".encode("utf-8", "surrogateescape"))
    return digest.hexdigest()


def _as_input_error(error: Exception, path: Path) -> InputError:
    """Return an InputError that states the cause found in Mitsuba's message."""
    lines = [line.strip(" -") for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if "rror" in line or "expected" in line]
    reason = (telling or lines or [type(error).__name__])[-1]
    reason = re.split(r"\[\w+\.(?:cpp|h):\d+\]\s*", reason)[-1]  # the last cause, without Mitsuba's source lines
    remedy = "correct the file or the -D values"
    if "PLY" in reason:
        remedy = "convert the mesh with 'correlograph mesh INPUT OUTPUT.ply'"
    return InputError("scene", "a scene that Mitsuba can load", f"{path} ({reason})", remedy)
