"""`python -m sim.mesh INPUT OUTPUT.ply`: convert a mesh that trimesh reads (STL, OBJ, PLY, GLB) to PLY for a scene.

Mitsuba does not read STL, and scenes need flat faces in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError
from correlograph.files.manifest import claim
from correlograph.files.output import atomic
from correlograph.ranges import SI


def check_faces(file: Path) -> None:
    """Raise InputError for a PLY file whose faces name vertices that it lacks: Mitsuba would read beyond its memory."""
    import trimesh

    found = ""
    try:
        mesh = trimesh.load(file, file_type="ply", force="mesh", process=False)
        outside = mesh.faces[(mesh.faces < 0) | (mesh.faces >= len(mesh.vertices))]
        found = f"vertex {outside[0]} of {len(mesh.vertices)}" if len(outside) else ""
    except IndexError as error:  # it looks up texture coordinates of each face
        found = str(error)
    except Exception:  # every loader raises its own exceptions; Mitsuba names the cause
        return
    if found:
        raise InputError(file.name, "faces of its own vertices, numbered from 0", found, "export the mesh again")


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m sim.mesh", description="Convert a mesh to PLY, in metres, for a scene.")
    p.add_argument("input", type=Path)
    p.add_argument("output", type=Path)
    p.add_argument("--unit-m", type=SI, default=1.0, help="metres per unit of the input (0.001 for millimetres)")
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    options = parser().parse_args(argv)
    if options.output.suffix.lower() != ".ply":
        raise InputError("output", "a name that ends in .ply", options.output, "use another name")
    if not options.input.is_file():
        raise InputError("input", "a mesh", f"no {options.input}", "check the path")
    claim(options.output.parent, [options.output.name], overwrite=options.overwrite)
    import trimesh

    try:
        mesh = trimesh.load(options.input, force="mesh")
        mesh.apply_scale(options.unit_m)
    except Exception as error:  # every loader raises its own exceptions
        raise InputError(
            "input", "a mesh that can be read", f"{options.input} ({type(error).__name__})", "export it again"
        ) from None
    far = float(np.abs(mesh.vertices).max(initial=0.0))
    if len(mesh.faces) and not 1e-9 < far < 1e9:
        raise InputError("input", "a mesh between 1 nm and 1e9 m", f"{far:.3g} m", "correct --unit-m")
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        raise InputError(
            "input",
            "a mesh of triangles at finite places",
            f"{len(mesh.faces)} triangles in {options.input}",
            "export it again",
        )
    with atomic(options.output) as partial:
        partial.write_bytes(mesh.export(file_type="ply", vertex_normal=False))
    size = " x ".join(f"{extent * 1e3:.3g}" for extent in mesh.extents)
    print(f"{options.output}: {len(mesh.faces)} triangles, {size} mm")


if __name__ == "__main__":
    run_command(main)
