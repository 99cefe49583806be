"""Whether frames show speckle that travels: a moving object, or a moving camera, with the laser at rest.

Frames whose laser spot was moved have independent speckle. What they share is static light, and a moving camera shifts that. If they
share the speckle itself, then most of its power appears in the cross-correlation of consecutive frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from correlograph.files.capture import Capture
from invert.tracking.shifts import cross_correlation, find_shift
from invert.tracking.track import FRAMES_FOR_WEIGHTS, MIN_SIGNIFICANCE, correlate_consecutive

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
    weights, signal, correlation = correlate_consecutive(first, 1)
    common, shape = find_shift(correlation), correlation.shape
    whole = (len(first.frames) - 1) * float(cross_correlation(signal, weights, shape)[0, 0])
    place = tuple(np.round(common.pixels).astype(int))
    share = float(correlation[place]) / whole if whole > 0.0 else 0.0
    overlap = np.prod(1.0 - np.abs(common.pixels) / np.array(shape))
    share /= float(max(overlap, 0.1))
    return Travel(common.pixels, share) if common.significance > MIN_SIGNIFICANCE and share > MIN_SHARE else None
