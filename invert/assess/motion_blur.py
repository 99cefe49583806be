"""Whether the speckle of a moving object is blurred, because it travels while the shutter is open."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from invert.assess.doubts import FALSE_ALARMS_EACH, Doubt, DoubtKind
from invert.measure.estimate import EstimateRecord
from invert.measure.patch_fit import signal_extent_lags
from invert.measure.spectrum import Measurement
from radiometry.motion import MAX_TURNS

MIN_SQUARED_CONTRAST = 0.4
"""Squared contrast of the speckle of a moving object below which its image may be wrong; two polarisations leave a half. Evidence:
docs/cameras.md."""


def doubt_motion(path_pixels: np.ndarray, record: EstimateRecord | None, measurement: Measurement) -> tuple[Doubt, ...]:
    """Return the doubt that motion blurs the speckle; none if it travels too little, or if its contrast was not measured.

    Args:
        path_pixels: position of the speckle in each frame, (frames, 2).
    """
    if record is None or record.contrast is None:
        return ()
    way = np.abs(np.diff(path_pixels, axis=0)).mean(0)
    turns = float((way * signal_extent_lags(measurement) / np.array(record.grid.patch_shape)).sum())
    if turns <= MAX_TURNS:  # no shutter blurs them
        return ()
    square, width = record.contrast.square, float(norm.isf(FALSE_ALARMS_EACH)) * record.contrast.error
    rows, columns = way
    advice = (
        f"the squared contrast of the speckle is {square:.2g}, and it travels by {rows:.1f} rows and {columns:.1f} columns from frame to "
        "frame: motion during the exposure seems to blur it; expose for less time (python -m radiometry.plan SCENE --moving)"
    )
    return (Doubt(DoubtKind.MOTION_BLUR, square, MIN_SQUARED_CONTRAST - width, FALSE_ALARMS_EACH, advice, is_low=True),)
