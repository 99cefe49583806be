"""Coherent simulator: speckle frames of a Mitsuba scene file.

    scene.py         loaded scene: geometry, plan, drawing, sweeps
    rendering.py     render and wall_field; sim.json
    recording.py     frames of a plan, with their headers, for all who draw some
    scene_drawing.py drawing of a scene to scale
    scene_file.py    loading and checking of a scene file, digest of its content
    coloured_bitmaps.py  notes on coloured albedos
    backend/         libLLVM and Mitsuba variant
    plugins/         laser, phase_screen, speckle_camera: the scene vocabulary (table.py lists its parameters)
    integrators/     speckle, throughput: frames and light budget by mi.render
    scene_reader.py  scene -> Geometry, validated (scene_checks.py: rays and sizes)
    geometry.py      spot, object, wall, camera (camera_view.py), light path
    trajectory.py    motion of objects and camera over time
    laser_speckle.py grains of the laser's light on the object, and places in it
    foreseen.py      how far a scene moves, and the periods that this needs
    transport/       light as rays: surfaces, light budget, object as seen from the virtual detector, Monte Carlo
    optics/          light as waves: illumination, motion, coherence, camera
    propagation/     object -> virtual detector, one propagator per file
    scene_warnings.py  parts of a scene that frames or predictions do not show as expected
    plan.py effects.py  selection of effects and propagator with predicted errors (plan_report.py: as text and JSON)
    frame.py         simulation of one frame
    gradients.py     derivatives of the expectation, in torch
    memory_effect.py the same scene by speckle correlation through the memory effect
    mesh.py          conversion of meshes (command)
    __main__.py      the command

The import sets a Mitsuba variant (unless one is set) and registers the plugins, so that
`mi.load_file("scene.xml", optimize=False)` and `mi.render(scene, seed=1)` work.
"""

import sys
from functools import cache
from typing import TYPE_CHECKING, Any

import lazy_loader

if TYPE_CHECKING:
    from sim.plan import Settings
    from sim.rendering import render, wall_field
    from sim.scene import Scene, load

__all__ = ["Scene", "Settings", "activate", "load", "render", "wall_field"]
_load_attribute, __dir__, _ = lazy_loader.attach(
    __name__, submod_attrs={"plan": ["Settings"], "rendering": ["render", "wall_field"], "scene": ["Scene", "load"]}
)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from correlograph.version import version

        return version()
    return _load_attribute(name)


@cache
def activate() -> str:
    """Set a Mitsuba variant, unless one is set, and register the plugins; return the variant.

    Raises InputError if no variant can run on this machine.
    """
    from sim.backend.variant import activate_variant

    variant = activate_variant()
    from sim.integrators import register_integrators  # these two need the variant
    from sim.plugins import register_plugins

    register_plugins()
    register_integrators()
    return variant


if sys.argv[0] != "-m":  # `python -m sim` imports the package before its command can report an error
    activate()
