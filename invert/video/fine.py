"""Fields of the frames in each window of a film, with its coarse images as prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from skimage.transform import resize
from tqdm import tqdm

from correlograph.files.capture import Capture
from invert.measure.estimate import apply_blur_transfer
from invert.measure.spectrum import read_measurement
from invert.output.result import Result
from invert.pipeline import add_fields
from invert.request import Request
from invert.video.looks import Looks
from invert.video.turning import turn
from invert.video.windows import Window


def retrieve_fields(
    request: Request, capture: Capture, looks: Looks, still: Window, coarse: list[Result], times: np.ndarray
) -> tuple[list[Result], list[str]]:
    """Return a result with fields for each window in which the object is at rest, at its own angle, and notes.

    Args:
        capture: one frame for each look.
        still: window in which the object stays the same without being turned back.
        coarse: results at some times, turned back, each registered to the one before.
        times: number of the look of each of these results.
    """
    found, notes, reasons = [], [], []
    for middle in tqdm(still.middles(), desc="fields", unit="image", disable=None, leave=False):
        nearest = coarse[int(np.argmin(np.abs(times - middle)))]
        numbers = range(*still.around(middle).indices(len(capture.frames)))
        frames = replace(capture, frames=[capture.frames[number] for number in numbers], names=(), headers=())
        weights = still.weights(middle) * looks.noise**-2.0
        estimate = looks.combine(looks.values, weights / weights.sum())
        if estimate.blur_pixels is None and nearest.estimate.blur_pixels is not None:
            estimate = apply_blur_transfer(estimate, nearest.estimate.blur_pixels)
        prior = replace(nearest.reconstruction, albedo=turn(nearest.coarse_albedo, looks.turns[middle], looks.aspect).clip(0.0))
        own = read_measurement(estimate.values, estimate.quantisation, estimate.transfer)
        result, more = add_fields(request, frames, replace(nearest, estimate=estimate, measurement=own, reconstruction=prior))
        found.append(result)
        if result.fields is None:
            reasons += more
        else:
            notes += more
    if reasons:
        notes.append(f"{len(reasons)} of {len(found)} images show the coarse albedo; the first because {reasons[0]}")
    return found, notes


def of_one_size(albedos: list[np.ndarray]) -> list[np.ndarray]:
    """Return albedos interpolated to the largest of them; images without fields have fewer pixels."""
    side = max(len(one) for one in albedos)
    return [one if len(one) == side else resize(one, (side, side), order=3).clip(0.0).astype(np.float32) for one in albedos]
