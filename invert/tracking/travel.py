"""Whether frames show speckle that travels: a moving object, or a moving camera, with the laser at rest.

Frames whose laser spot was moved have independent speckle. What they share is static light, and a moving camera shifts that. If they
share the speckle itself, then most of its power appears in the cross-correlation of consecutive frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from correlograph.files.capture import Capture
from invert.tracking.shifts import cross_correlation, find_shift, weights_of
from invert.tracking.track import FRAMES_FOR_WEIGHTS, MIN_SIGNIFICANCE, mean_power, summed_cross_spectrum

MIN_SHARE = 0.5
"""Share of the speckle in common above which it counts as one speckle that travels; the rest could be static light."""


@dataclass(frozen=True)
class Travel:
    """Mean displacement of the speckle from frame to frame in pixels (2,), and the share of its power that consecutive frames have in
    common at this displacement.
    """

    step_pixels: np.ndarray
    share: float

    def describe(self) -> str:
        """Return a note for a result."""
        rows, columns = self.step_pixels
        return (
            f"the speckle travels by about {rows:.1f} rows and {columns:.1f} columns from frame to frame, as if the object moved and the "
            "laser did not; frames were pooled without subtraction of what they share; python -m invert.track shows the path"
        )


def find_travel(capture: Capture) -> Travel | None:
    """Return how the speckle of a capture travels; None if consecutive frames have less than `MIN_SHARE` of it in common."""
    first = replace(capture, frames=capture.frames[:FRAMES_FOR_WEIGHTS], headers=(), names=())
    shape = (first.frames[0].shape[0], first.frames[0].shape[1])
    weights, signal = weights_of(mean_power(first, 1), len(first.frames))
    pairs = len(first.frames) - 1
    correlation = cross_correlation(summed_cross_spectrum(first, 1), weights, shape) / pairs
    common = find_shift(correlation)
    whole = float(torch.fft.irfft2(signal * weights, s=shape)[0, 0])
    place = tuple(np.round(common.pixels).astype(int))
    share = float(correlation[place]) / whole if whole > 0.0 else 0.0
    overlap = np.prod(1.0 - np.abs(common.pixels) / np.array(shape))
    share /= float(max(overlap, 0.1))
    return Travel(common.pixels, share) if common.significance > MIN_SIGNIFICANCE and share > MIN_SHARE else None
