"""Selection of the Mitsuba variant, and the one-line error if none can run."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from xml.etree import ElementTree

from correlograph.errors import InputError
from correlograph.files.output import silence_output
from sim.backend.libllvm import MIN_LLVM_VERSION, newest_preferred, version_of

with silence_output():  # `activate_variant` reports a missing libLLVM on one line
    import drjit as dr
    import mitsuba as mi


MIN_THREADS = 2
"""Least number of threads of Dr.Jit. On one, which a process that may use one core has, Mitsuba waits without end for the threads that read
and write images (mitsuba3, issue 21)."""


def activate_variant() -> str:
    """Keep the variant that is set; otherwise set `cuda_ad_mono` if a GPU works, else `llvm_ad_mono`.

    Raises InputError for a variant that is not vectorised, and for a missing libLLVM.
    """
    with newest_preferred():
        has_cuda, has_llvm = (dr.has_backend(backend) for backend in (dr.JitBackend.CUDA, dr.JitBackend.LLVM))
    current = mi.variant()
    if current is None:
        if has_cuda:
            mi.set_variant("cuda_ad_mono")
        elif has_llvm:
            mi.set_variant("llvm_ad_mono")
        else:
            raise InputError(
                "libLLVM",
                "a system libLLVM (or a CUDA GPU) for Mitsuba to compile with",
                "neither",
                "install it: 'apt-get install libllvm19' on Debian and Ubuntu, 'brew install llvm' on "
                "macOS, or set DRJIT_LIBLLVM_PATH",
            )
    elif not current.startswith(("llvm", "cuda")):
        raise InputError(
            "Mitsuba variant", "an llvm_* or cuda_* variant", current, "call mi.set_variant('llvm_ad_mono') before 'import sim'"
        )
    dr.set_thread_count(max(MIN_THREADS, dr.thread_count()))
    return mi.variant()


def log_to_standard_error() -> None:
    """Print Mitsuba's messages on standard error, because commands print results on standard output."""

    class StandardError(mi.Appender):  # Mitsuba has this class only after a variant is set
        def append(self, level: mi.LogLevel, text: str) -> None:
            print(text, file=sys.stderr)

        def log_progress(self, *_: object) -> None:
            pass

    logger = mi.logger()
    logger.clear_appenders()
    logger.add_appender(StandardError())


_PLAIN_EMITTERS = ("Emitter", "AreaLight", "PointLight", "SpotLight")
"""Emitters that an older libLLVM compiles; an emitter written in Python, such as the laser, has the name of its base class."""
_PLAIN_SURFACES = {
    "SmoothDiffuse",
    "TwoSided",
    "Null",
    "PhaseScreen",
    "UniformSpectrum",
    "BitmapTexture",
    "Checkerboard",
    "Transform",
    "MeshAttribute",
}
"""Surface plugins that an older libLLVM compiles, for meshes."""


def llvm_major() -> int | None:
    """Return the major version of the libLLVM in use, None if it is unknown."""
    maps = Path("/proc/self/maps")
    loaded = re.findall(r"/\S*libLLVM\S*", maps.read_text()) if maps.is_file() else []
    return version_of(loaded[0]) if loaded else None


def _old_llvm() -> int | None:
    """Return the version in use if it is too old to compile all of Mitsuba."""
    major = llvm_major()
    return major if major is not None and major < MIN_LLVM_VERSION and mi.variant().startswith("llvm") else None


MAX_NESTING_DEPTH = 40
"""Maximum nesting depth of the elements of a scene file."""


def _depth(root: ElementTree.Element) -> int:
    level, deep = [root], 0
    while level:
        level = [child for node in level for child in node]
        deep += 1
    return deep


def check_loadable(root: ElementTree.Element) -> None:
    """Check the XML of a scene before Mitsuba loads it: smooth normals need a recent libLLVM, colours have no meaning
    for light of one wavelength, and Mitsuba does not terminate on unlimited plugin nesting."""
    if (colour := next(root.iter("rgb"), None)) is not None:
        raise InputError(
            f"rgb {colour.get('name')}",
            "a value at the laser's wavelength",
            f"the colour {colour.get('value')}",
            f'write <spectrum name="{colour.get("name")}" value="..."/>',
        )
    for node in root.iter():
        if node.get("type") == "bitmap" and not any(child.get("name") in ("filename", "data", "bitmap") for child in node):
            raise InputError(node.get("name") or "bitmap", "a texture with a file name", "none", "add its filename")
    if (depth := _depth(root)) > MAX_NESTING_DEPTH:
        raise InputError(
            "scene", f"elements nested up to {MAX_NESTING_DEPTH} deep", f"{depth}", "take some plugins out of one another"
        )
    major = _old_llvm()
    for node in root.iter("shape"):
        flat = any(child.get("name") == "face_normals" and child.get("value") == "true" for child in node)
        if major and node.get("type") in ("ply", "obj") and not flat:
            raise InputError(
                node.get("id", "shape"),
                f"libLLVM {MIN_LLVM_VERSION} or newer for a mesh with smooth normals",
                f"libLLVM {major}",
                '\'apt-get install libllvm19\', or give the mesh <boolean name="face_normals" value="true"/>',
            )


def check_compilable(scene: mi.Scene) -> None:
    """Refuse plugins that an older libLLVM cannot compile, because the attempt would end the process without a message.

    Dr.Jit's minimum and maximum need LLVM 17 on x86; spheres, disks, cylinders and microfacet BSDFs use them.
    """
    major = _old_llvm()
    if major is None:
        return
    for emitter in scene.emitters():
        kind = emitter.class_name()
        if kind not in _PLAIN_EMITTERS:
            raise InputError(
                emitter.id() or "emitter",
                f"libLLVM {MIN_LLVM_VERSION} or newer to compile a {kind}",
                f"libLLVM {major}",
                "'apt-get install libllvm19', or use area, point and spot emitters",
            )
    for shape in scene.shapes():
        culprits = sorted(set(re.findall(r"([A-Za-z]\w*(?: BSDF)?)\s*[\[:]\n", f"{shape.bsdf()}\n")) - _PLAIN_SURFACES)
        if not shape.is_mesh():
            culprits.append(shape.class_name())
        for culprit in culprits:
            raise InputError(
                shape.id() or "shape",
                f"libLLVM {MIN_LLVM_VERSION} or newer to compile a {culprit}",
                f"libLLVM {major}",
                "'apt-get install libllvm19', or use meshes and diffuse surfaces",
            )
