"""Whether frames show speckle that travels: a moving object, or a moving camera, with the laser at rest.

Frames whose laser spot was moved have independent speckle. What they share is static light, and a moving camera shifts that. If they
share the speckle itself, then most of its power appears in the cross-correlation of consecutive frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import Capture
from invert.tracking.spectra import FRAMES_FOR_POWER, Reader
from invert.tracking.start import find_objects, share_along

MIN_SHARE = 0.6
"""Share of the speckle in common above which it counts as speckle that travels; the rest could be static light."""


@dataclass(frozen=True)
class Travel:
    """Mean displacement of the speckle from frame to frame in pixels, of each object (k, 2), and the share of its power that consecutive
    frames have in common at these displacements.
    """

    steps_pixels: np.ndarray
    share: float

    def describe(self) -> str:
        """Return a note for a result."""
        ways = ", and by ".join(f"{rows:.1f} rows and {columns:.1f} columns" for rows, columns in self.steps_pixels)
        return (
            f"the speckle travels by about {ways} from frame to frame, as if the object moved and the "
            "laser did not; frames were pooled without subtraction of what they share; python -m invert.track shows the path"
        )


def find_travel(capture: Capture) -> Travel | None:
    """Return how the speckle of a capture travels; None if consecutive frames have less than `MIN_SHARE` of it in common."""
    first = capture.frames[:FRAMES_FOR_POWER]
    reader = Reader(first[0].shape, 1)
    band = reader.band(first)
    if band is None or len(first) < 2:
        return None
    spectra = np.stack([reader.spectra(frame, band) for frame in first])
    try:
        found = find_objects(spectra, band)
    except InputError:
        return None
    share = sum(share_along(spectra, band, one.path, 1) for one in found)
    steps = np.array([one.path[-1] / (len(first) - 1) for one in found])
    return Travel(steps, share) if share > MIN_SHARE else None
