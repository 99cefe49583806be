"""Reconstruction: speckle frames, or their autocorrelation, to the albedo of the hidden object.

    pipeline.py      the one path from a source to a result: `reconstruct`
    request.py       options of a reconstruction, checked once
    sources.py       files, arrays, captures and estimates as sources
    choices.py       methods and qualities
    methods.py       reconstruction of a measurement by one method
    blur_fit.py      blind estimation of defocus and motion blur
    measure/         frames -> estimate -> measurement: noise level and Fourier modulus
    albedo/          albedo images: registration, posterior samples, scores
    likelihood/      likelihood of albedos, and refinement by it
    solvers/         classical phase retrieval, one method per file
    field/           the complex field of each frame, and the fine albedo
    network/         the network: features, architecture, posterior sampling, weights files
    assess/          consistency with speckle, confidence, warnings
    output/          results: figures and files
    tracking/        paths and rotations of moving objects
    video/           films of moving objects
    batch/           captures of the command: one, or many on workers
    training/        training of the network (commands: train.py, warm_starts.py, calibrate.py)
    evaluation/      comparison of methods on test sets (command: evaluate.py)
    __main__.py      the command

Only the rendered test sets of the evaluation import Mitsuba.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from correlograph.files.capture import CameraMetadata, Capture
    from correlograph.files.corrections import Corrections
    from invert.albedo.posterior import Samples
    from invert.output.result import Result
    from invert.pipeline import reconstruct

    CameraFacts = CameraMetadata

__all__ = ["CameraFacts", "CameraMetadata", "Capture", "Corrections", "Result", "Samples", "reconstruct"]

_MODULES = {
    "CameraFacts": "correlograph.files.capture",
    "CameraMetadata": "correlograph.files.capture",
    "Capture": "correlograph.files.capture",
    "Corrections": "correlograph.files.corrections",
    "Result": "invert.output.result",
    "Samples": "invert.albedo.posterior",
    "reconstruct": "invert.pipeline",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from correlograph.version import version

        return version()
    from correlograph.lazy import load_attribute

    return load_attribute(__name__, _MODULES, name)
