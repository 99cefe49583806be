"""correlograph: speckle frames of hidden objects, and the objects from speckle frames.

    import correlograph as cg

    scene = cg.load("corner_letter", exposure=0.125)
    capture = cg.render(scene, frames=2, seed=1)
    result = cg.reconstruct(capture)

This package holds the public interface and what all other packages share. The public interface:

    __init__.py     the public interface, imported when it is used
    cli.py          the `correlograph` command
    commands/       commands that need a scene and radiometry: light budget, exposure plan, noise validation
    doctor.py       components that this machine lacks

The foundation, which every other package imports:

    errors.py       InputError: name, expected, found, remedy
    command.py      argument parsing, exit codes, interruption
    ranges.py       ranges of numbers, for options and arguments
    lags.py         the lag grid
    progress.py     how long work reports its progress
    files/          captures, frames, images, stores, output files
    workers.py      parallel tasks: processes, or a Dask cluster
    lazy.py         public names that are imported when they are used
    version.py      version of the installed package, digest of its code
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from correlograph.errors import InputError
    from correlograph.files.capture import CameraMetadata, Capture
    from correlograph.files.corrections import Corrections
    from invert.albedo.metrics import Scores, aligned_pearson, score
    from invert.albedo.posterior import Samples
    from invert.field.field import Field
    from invert.output.result import Result
    from invert.output.truth import Truth
    from invert.pipeline import reconstruct
    from invert.tracking.rotation import Rotation, track_rotation
    from invert.tracking.track import Track
    from invert.tracking.tracker import track
    from invert.video.film import Film
    from invert.video.video import film
    from sim.plan import Settings
    from sim.rendering import render
    from sim.scene import Scene, load
    from sim.scene_forecast import Forecast, light_budget, predict

_MODULES = {
    "CameraMetadata": "correlograph.files.capture",
    "Capture": "correlograph.files.capture",
    "Corrections": "correlograph.files.corrections",
    "Field": "invert.field.field",
    "Film": "invert.video.film",
    "Forecast": "sim.scene_forecast",
    "InputError": "correlograph.errors",
    "Result": "invert.output.result",
    "Rotation": "invert.tracking.rotation",
    "Samples": "invert.albedo.posterior",
    "Scene": "sim.scene",
    "Scores": "invert.albedo.metrics",
    "Settings": "sim.plan",
    "Track": "invert.tracking.track",
    "Truth": "invert.output.truth",
    "aligned_pearson": "invert.albedo.metrics",
    "film": "invert.video.video",
    "light_budget": "sim.scene_forecast",
    "load": "sim.scene",
    "predict": "sim.scene_forecast",
    "reconstruct": "invert.pipeline",
    "render": "sim.rendering",
    "score": "invert.albedo.metrics",
    "track": "invert.tracking.tracker",
    "track_rotation": "invert.tracking.rotation",
}

__all__ = [
    "CameraMetadata",
    "Capture",
    "Corrections",
    "Field",
    "Film",
    "Forecast",
    "InputError",
    "Result",
    "Rotation",
    "Samples",
    "Scene",
    "Scores",
    "Settings",
    "Track",
    "Truth",
    "aligned_pearson",
    "film",
    "light_budget",
    "load",
    "predict",
    "reconstruct",
    "render",
    "score",
    "track",
    "track_rotation",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from correlograph.version import version

        return version()
    from correlograph.lazy import load_attribute

    return load_attribute(__name__, _MODULES, name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
