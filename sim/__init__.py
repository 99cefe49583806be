"""Coherent simulator: one Mitsuba scene file in, speckle frames out.

    scene.py         load, render, wall_field: the public face
    scene_file.py    loads and checks a scene file, hashes what it is made of
    libllvm.py variant.py  what Dr.Jit compiles with; the Mitsuba variant
    plugins/         laser, phase_screen, speckle_camera: the scene vocabulary (table.py lists its numbers)
    integrators/     speckle, throughput: frames and light budget by mi.render
    scene_reader.py  scene -> Geometry, validated
    geometry.py      distances, cosines, the light path
    transport/       light as rays: surfaces, light budget, the object seen from the wall, Monte Carlo
    optics/          light as waves: illumination, motion, coherence, camera
    propagation/     object -> virtual detector, one kernel a file
    plan.py effects.py  what is modelled, what is left out and why, at which predicted error (plan_report.py: to read)
    frame.py         the flow for one frame
    gradients.py     derivatives of the expectation, in torch
    memory_effect.py the same scene as speckle correlation through the memory effect shows it
    mesh.py          letters as meshes (command)
    __main__.py      the command

Importing it sets a Mitsuba variant (unless one is set) and registers the plugins, so that
`mi.load_file("scene.xml", optimize=False)` and `mi.render(scene, seed=1)` work.
"""

import sys
from functools import cache
from typing import TYPE_CHECKING

import lazy_loader

from correlograph.version import version

if TYPE_CHECKING:
    from sim.plan import Settings
    from sim.scene import Scene, load, render, wall_field

__all__ = ["Scene", "Settings", "activate", "load", "render", "wall_field"]
__version__ = version()
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__, submod_attrs={"plan": ["Settings"], "scene": ["Scene", "load", "render", "wall_field"]}
)


@cache
def activate() -> str:
    """Set a Mitsuba variant, unless one is set, and register the plugins; return the variant.

    Raises InputError if no variant can run on this machine.
    """
    from sim.variant import activate_variant

    variant = activate_variant()
    from sim.integrators import register_integrators  # these two need the variant
    from sim.plugins import register_plugins

    register_plugins()
    register_integrators()
    return variant


if sys.argv[0] != "-m":  # `python -m sim` imports the package before its command can report an error
    activate()
