"""Inversion: speckle frames, or their autocorrelation, to the hidden object's albedo.

    inversion.py     all of it in one call
    capture.py       reads and checks the frames of a capture
    estimate.py      frames -> autocorrelation estimate, with what is known of the camera
    patch_fit.py     lag pitch by the object's width (blur_fit.py: a blur that is not known)
    spectrum.py      noisy estimate -> noise level, detection, Fourier modulus
    methods.py       from a measurement to an albedo, by any method
    solvers/         classical phase retrieval, one method a file
    network/         the network: features, architecture, inference, weights files
    likelihood.py    log-likelihood of albedos under the noise model
    posterior.py     what samples say together: mean, spread, answers, sizes
    refinement.py    likelihood ascent of a reconstruction, judged by lags it has not seen
    registration.py  shift and twin image; registered mean of many starts
    speckle_test.py  whether the light is speckle of the reconstruction
    trust.py         confidence and warnings that follow
    captures.py      captures among the inputs of the command; one inverted (many_captures.py: all, on workers)
    metrics.py       scores against a truth; agreement without one
    result.py        the files of a result (report.py: its picture)
    training/        how the network is trained: train.py, warm_starts.py, calibrate.py are its commands
    evaluation/      methods compared on test sets: evaluate.py is its command
    __main__.py      the command

Nothing here imports Mitsuba but the evaluation's test sets of rendered frames.
"""

from typing import TYPE_CHECKING

import lazy_loader

from correlograph.version import version

if TYPE_CHECKING:
    from invert.pipeline import CameraFacts, Capture, Corrections, Result, reconstruct

__all__ = ["CameraFacts", "Capture", "Corrections", "Result", "reconstruct"]
__version__ = version()
__getattr__, __dir__, _ = lazy_loader.attach(__name__, submod_attrs={"inversion": __all__})
