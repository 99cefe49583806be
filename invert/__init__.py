"""Inversion: speckle frames, or their autocorrelation, to the hidden object's albedo.

    capture.py       reads frames and autocorrelation pictures, checks them
    estimate.py      frames -> autocorrelation estimate, with what is known of the camera
    spectrum.py      noisy estimate -> noise level, detection, Fourier modulus
    methods.py solvers.py   retrieval methods by name; the classical ones' options
    projections.py   what they share: projections, support, starts, residual
    hio.py raar.py error_reduction.py altmin.py admm_tv.py twf.py mtwf.py taf.py   one method a file
    registration.py  shift and 180-degree turn; registered mean of many starts
    features.py blocks.py unet.py learned.py weights.py   the network: what it sees, what it is, how it is used and stored
    proposals.py likelihood.py   what classical retrieval proposes to it, and which of its drawings the estimate speaks for
    paper_unet.py    the paper's network, the baseline
    train.py training_data.py losses.py warm_starts.py training_report.py calibrate.py   how it is trained
    metrics.py       scores against a truth; agreement without one
    identification.py  which character a picture shows
    evaluate.py evaluation_sets.py evaluation_report.py   methods compared on test sets
    report.py        the picture of a result
    result.py        the files of a result
    __main__.py      the command

    inversion.py     all of it in one call

Nothing here imports Mitsuba.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from invert.inversion import Result, reconstruct
    from radiometry.capture import CameraFacts, Capture

__all__ = ["CameraFacts", "Capture", "Result", "reconstruct"]


def __getattr__(name: str) -> Any:
    """The public names, imported when first asked for."""
    if name in ("Result", "reconstruct"):
        from importlib import import_module

        return getattr(import_module("invert.inversion"), name)
    if name in __all__:
        from radiometry import capture

        return getattr(capture, name)
    raise AttributeError(f"module 'invert' has no attribute {name!r}")

