"""How far a reconstruction is to be trusted beyond what its method says, and what a user must know of the frames."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch

from correlograph.lags import OBJECT_SIDE
from invert.albedo.posterior import Posterior
from invert.assess.speckle_test import SpeckleTest
from invert.likelihood.gamma import NoiseLikelihood
from invert.measure.patch_fit import overfull
from invert.measure.spectrum import Measurement
from invert.methods import Reconstruction

DOUBTFUL = 0.5
"""Largest confidence in a reconstruction from light that need not be speckle, or that it does not explain."""

TEXTURE, GLINT = 0.25, 1.8
"""Third moment, over that of speckle, below which light is texture, and above which something else shines."""

UNEXPLAINED = 0.35

UNFITTED_NATS, UNFITTED_SHARE = 100.0, 0.04
"""Misfit of the likeliest sample, in nats and over that of no object, from which the object is not among the samples. Of 120
edges, characters and grey objects at eight noise levels four are beyond both, dense edges with a correlation below .35."""

SATURATED = 1e-3
SAME_SPECKLE = 0.3


def trusted(found: Reconstruction, test: SpeckleTest | None, measurement: Measurement, likelihood: NoiseLikelihood,
            facts: dict[str, Any]) -> tuple[Reconstruction, list[str]]:
    """Lower the confidence where the light is not shown to be speckle of this object; and the warnings of a capture.

    Args:
        likelihood: of the estimate as it is: noise is even in lags that were not divided by the camera's transfer.
        facts: of the estimate: number of frames, and what the mean model found.
    """
    doubts = [] if test is None or test.third_moment is None else _doubts(test, facts["frames"])
    if found.posterior is not None:
        doubts += _of_samples(found.posterior, likelihood)
    warnings = doubts + _of_frames(facts.get("mean_model", {}), facts.get("frames", 0))
    if "blur_found_pixels" in facts:
        down, right = facts["blur_found_pixels"]
        warnings.append(f"frames look blurred, as if by {down:.1f}, {right:.1f} pixels (down, right), unless the object has "
                        "soft edges; that was undone; check focus and motion, or give --blur-pixels, 0 for none")
    if "patches" in facts and overfull(measurement):
        warnings.append("the object may be wider than the lags show; try --patch fit, or frames of smaller pixels")
    return (replace(found, confidence=min(found.confidence, DOUBTFUL)) if doubts else found), warnings


def _doubts(test: SpeckleTest, frames: int) -> list[str]:
    moment, error = test.third_moment or 0.0, 2.0 * (test.error or 0.0)
    shown = f"third moment {moment:.2g} +- {0.5 * error:.2g} times that of speckle"
    if moment - error > GLINT:
        return [f"the light is no speckle of one object ({shown}); look for a glint or a moving lamp"]
    if moment + error < TEXTURE:
        return [f"the light is no speckle ({shown}); look for texture of the wall, or saturated frames"]
    if test.unexplained > UNEXPLAINED:
        return [f"the reconstruction leaves {100.0 * test.unexplained:.0f} % of the estimate's signal unexplained"]
    if frames == 1 and moment - error < TEXTURE:
        return [f"one frame does not tell an object from texture of the wall ({shown}); add one of another illumination"]
    return []


def _of_samples(drawn: Posterior, likelihood: NoiseLikelihood) -> list[str]:
    least = min(likelihood.misfit(torch.from_numpy(sample)) for sample in drawn.samples)
    nothing = likelihood.misfit(torch.zeros(OBJECT_SIDE, OBJECT_SIDE))
    if least <= max(UNFITTED_NATS, UNFITTED_SHARE * nothing):
        return []
    return [f"no sample explains the estimate (the likeliest misses it by {least:.0f} nats, no object by {nothing:.0f}), so "
            "probabilities and intervals are too narrow; try --quality best"]


def _of_frames(found: dict[str, Any], frames: int) -> list[str]:
    """What the estimator found and dealt with."""
    shift = found.get("shift_pixels", (0.0, 0.0))
    remarks = [
        (found.get("frames_correlate", 0.0) > SAME_SPECKLE,
         f"frames share {100.0 * found.get('frames_correlate', 0.0):.0f} % of their power; was the laser moved between them?"),
        (found.get("saturated", 0.0) > SATURATED, f"{100.0 * found.get('saturated', 0.0):.2g} % of the pixels are saturated"),
        (found.get("hot_pixels", 0) > 0, f"{found.get('hot_pixels')} hot pixels, or pixels of glints, were replaced"),
        (found.get("faulty_lines", 0) > 0, f"{found.get('faulty_lines')} rows or columns were replaced by their neighbours"),
        (found.get("spectral_lines", 0) > 0, f"{found.get('spectral_lines')} waves (fringes or lamp banding) were subtracted"),
        (max(map(abs, shift)) > 0.2, f"the camera moved by {shift[0]:.1f}, {shift[1]:.1f} pixels between frames"),
        (frames > 1 and found.get("fixed_pattern_lags", 0.0) > 0.1,
         f"frames share a pattern, subtracted at {100.0 * found.get('fixed_pattern_lags', 0.0):.0f} % of the lags"),
    ]
    return [text for shown, text in remarks if shown]
