"""Sources of a reconstruction: files, arrays, captures, estimates."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata, Capture, check_unmasked
from correlograph.files.captured_frames import check_frames_in_memory, read_capture
from correlograph.files.images import check_symmetry
from correlograph.files.stacks import open_stack
from correlograph.lags import LAG_SIDE
from correlograph.ranges import LAG_COUNT
from invert.measure.estimate import Estimate, check_power, published_estimate

Source = Capture | Estimate | str | Path | Sequence[str | Path] | np.ndarray | Sequence[np.ndarray]


def read_source(source: Source, camera: CameraMetadata, autocorrelation: bool | None = None) -> Capture | Estimate:
    """Read a source as a capture, or as an estimate if it is an autocorrelation. The arguments have the same meaning as in
    `reconstruct`.
    """
    if isinstance(source, Capture):
        check_frames_in_memory(source.frames)
        return source
    if isinstance(source, Estimate):
        return source
    if isinstance(source, (str, Path)):
        source = [source]
    paths = [Path(item) for item in source if isinstance(item, (str, Path))] if isinstance(source, Sequence) else []
    if paths and len(paths) == len(source):
        if autocorrelation and len(paths) > 1:
            raise InputError("frames", "one file with --autocorrelation", f"{len(paths)} files", "give them one by one")
        if autocorrelation or (autocorrelation is None and len(paths) == 1 and _has_published_shape(paths[0])):
            return published_estimate(paths[0])
        return read_capture(paths, camera)
    return _read_array(source, camera, autocorrelation)


def _read_array(source: object, camera: CameraMetadata, autocorrelation: bool | None) -> Capture | Estimate:
    check_unmasked(source)
    try:
        array = np.asarray(source)
    except ValueError:
        raise InputError("frames", "frames of one size", "arrays of several shapes", "provide one array (n, H, W)") from None
    if (array.shape == (LAG_SIDE, LAG_SIDE) and autocorrelation is not False) or (autocorrelation and _is_of_lags(array)):
        if array.dtype.kind not in "uif":
            raise InputError("autocorrelation", "real numbers", f"{array.dtype}", "convert the array")
        check_power(array, "the array")
        check_symmetry(array, "the array")
        return Estimate("autocorrelation", np.array(array, np.float32))
    if autocorrelation:
        found = f"shape {array.shape}"
        expected = "an odd square array of 65 x 65 to 511 x 511 lags"
        raise InputError("autocorrelation", expected, found, "provide an estimate, or omit autocorrelation")
    if array.ndim == 2:
        array = array[None]
    if array.ndim != 3 or array.dtype.kind not in "uif" or len(array) == 0:
        found = f"{array.dtype} of shape {array.shape}"
        raise InputError("frames", "numbers of shape (frames, height, width)", found, "provide one channel of intensity")
    frames = [np.array(frame, np.float32) for frame in array]
    check_frames_in_memory(frames)
    return Capture(frames, camera, tuple(f"frame {number}" for number in range(len(frames))))


def _is_of_lags(array: np.ndarray) -> bool:
    """Return whether an array has the shape of an estimate."""
    side = array.shape[-1] if array.ndim == 2 else 0
    return array.shape == (side, side) and side % 2 == 1 and LAG_COUNT.holds(side // 2)


def _has_published_shape(path: Path) -> bool:
    if not path.is_file():
        return False
    stack = open_stack(path)
    return stack.count == 1 and stack.read(0)[0].shape in ((LAG_SIDE, LAG_SIDE), (LAG_SIDE, 2 * LAG_SIDE))
