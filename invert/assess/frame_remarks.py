"""Remarks on the frames: background and sensor faults that the estimator found and corrected."""

from __future__ import annotations

from invert.measure.estimate import EstimateRecord
from invert.measure.patch_fit import is_wider_than_lags
from invert.measure.spectrum import Measurement

MAX_SATURATED_FRACTION = 1e-3
"""Maximum fraction of saturated pixels without a remark."""

MAX_FRAME_CORRELATION = 0.3
"""Maximum correlation of frames without a remark; correlated frames lower K."""

MAX_SHIFT_PIXELS = 0.2
"""Maximum shift of the camera between frames without a remark; the estimate corrects it."""

MAX_PATTERN_FRACTION = 0.1
"""Maximum fraction of lags at which a static pattern is subtracted without a remark."""


def has_shifted(record: EstimateRecord | None) -> bool:
    """Return whether the pattern that frames share moved between them."""
    shift = (record and record.background.shift_pixels) or (0.0, 0.0)
    return max(map(abs, shift)) > MAX_SHIFT_PIXELS


def describe_frames(record: EstimateRecord | None, measurement: Measurement) -> list[str]:
    """Describe the background and the sensor faults that the estimator found and corrected, and an object that may be too wide."""
    return _describe_faults(record) + _describe_width(record, measurement)


def _describe_width(record: EstimateRecord | None, measurement: Measurement) -> list[str]:
    if not is_wider_than_lags(measurement):
        return []
    remedy = "take more lags" if record is None else "try --patch fit, or frames with smaller pixels"
    return [f"the object may be wider than the lags; {remedy}"]


def _describe_faults(record: EstimateRecord | None) -> list[str]:
    if record is None:
        return []
    found = record.background
    shared, saturated = found.frames_correlate or 0.0, found.saturated or 0.0
    pattern, shift = found.fixed_pattern_lags or 0.0, found.shift_pixels or (0.0, 0.0)
    candidates = [
        (
            shared > MAX_FRAME_CORRELATION,
            f"frames correlate by {100.0 * shared:.0f} %; move the laser spot between frames",
        ),
        (saturated > MAX_SATURATED_FRACTION, f"{100.0 * saturated:.2g} % of the pixels are saturated; shorten the exposure"),
        (bool(found.hot_pixels), f"{found.hot_pixels} hot pixels or pixels of specular highlights were replaced"),
        (bool(found.faulty_lines), f"{found.faulty_lines} defective rows or columns were replaced by their neighbours"),
        (bool(found.spectral_lines), f"{found.spectral_lines} periodic waves (fringes or lamp flicker) were subtracted"),
        (
            has_shifted(record),
            f"the camera shifted by {shift[0]:.1f} rows and {shift[1]:.1f} columns between frames, "
            "or the laser was at rest while the object moved; fix its mount, or move the laser",
        ),
        (
            record.frames > 1 and pattern > MAX_PATTERN_FRACTION,
            f"frames share a static pattern, which was subtracted at {100.0 * pattern:.0f} % of the lags",
        ),
        (
            record.contrast is not None and record.contrast.is_too_high,
            "the contrast of the speckle is higher than light makes it; use raw frames (not sharpened, interpolated or filtered), check "
            "the offset of the camera, and light the wall evenly",
        ),
    ]
    remarks = [text for is_present, text in candidates if is_present]
    if record.blur_found_pixels is not None:
        rows, columns = record.blur_found_pixels
        remarks.append(
            f"frames look blurred by {rows:.1f} rows and {columns:.1f} columns, unless the object has soft edges; the blur was "
            "deconvolved; check focus and motion, or set --blur-pixels (0 for no blur)"
        )
    return remarks
