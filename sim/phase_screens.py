"""Phase screens of a scene: checks, shapes that move together, polarisation."""

from __future__ import annotations

import mitsuba as mi

from correlograph.errors import InputError
from sim.plugins.phase_screen import PhaseScreen
from sim.plugins.speckle_camera import SpeckleCamera
from sim.trajectory import Trajectory


def check_phase_screens(scene: mi.Scene, hidden: list[mi.Shape]) -> None:
    """Raise InputError for a phase_screen inside another BSDF, whose roughness and motion nothing would show, and for one that
    moves a shape other than a hidden object."""
    may_move = {shape.id() for shape in hidden}
    for shape in scene.shapes():
        name, bsdf = shape.id() or "shape", shape.bsdf()
        if bsdf is None:
            continue
        if any(parameter.endswith(".height_rms") for parameter, _ in mi.traverse(bsdf)):
            expected, found = "a phase_screen around other BSDFs", "one inside another BSDF"
            raise InputError(name, expected, found, "put twosided, mask and other BSDFs into the phase_screen")
        if shape.id() not in may_move and not _trajectory_of(shape).matches(Trajectory()):
            expected, remedy = "a shape at rest", "move a hidden_object, the laser (scan_speed) or the speckle_camera instead"
            raise InputError(name, expected, "a velocity, angular_velocity or trajectory", remedy)


def moving_together(shapes: list[mi.Shape]) -> list[tuple[list[mi.Shape], Trajectory]]:
    """Return the shapes of each hidden object, which share one motion, and this motion."""
    found: list[tuple[list[mi.Shape], Trajectory]] = []
    for shape in shapes:
        path = _trajectory_of(shape)
        same = next((group for group, known in found if known.matches(path)), None)
        if same is None:
            found.append(([shape], path))
        else:
            same.append(shape)
    return found


def is_depolarised(source: mi.Shape, hidden: list[mi.Shape], camera: SpeckleCamera) -> bool:
    """Return whether a frame contains both polarisations.

    Raises InputError if a part of the hidden object depolarises polarised light and another does not, and if the camera has polarisation
    channels but no surface depolarises.
    """
    polarised = [shape for shape in hidden if not _depolarises(shape)]
    is_mixed = _depolarises(source) or len(polarised) < len(hidden)
    if is_mixed and polarised and not _depolarises(source):
        expected, remedy = "the whole hidden object depolarising, or none of it", "set it everywhere, or at the virtual_source"
        found = f"not set at {', '.join(shape.id() for shape in polarised)}"
        raise InputError("phase_screen.depolarising", expected, found, remedy)
    if camera.polarisation_channels == 1:
        return is_mixed
    if not is_mixed:
        expected = "1, unless a phase_screen of source or object is depolarising"
        remedy = "set depolarising, because both channels show one speckle pattern otherwise"
        raise InputError("speckle_camera.polarisation_channels", expected, camera.polarisation_channels, remedy)
    return False


def _trajectory_of(shape: mi.Shape) -> Trajectory:
    return shape.bsdf().trajectory if isinstance(shape.bsdf(), PhaseScreen) else Trajectory()


def _depolarises(shape: mi.Shape) -> bool:
    return isinstance(shape.bsdf(), PhaseScreen) and shape.bsdf().depolarising
