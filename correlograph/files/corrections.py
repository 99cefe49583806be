"""Calibration frames of a camera: dark frames, flat-field frame and mask, applied to frames first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter

from correlograph.errors import InputError
from correlograph.files.capture import Capture
from correlograph.files.captured_frames import frames_inside
from correlograph.files.file_frames import FileFrames
from correlograph.files.images import as_frame, read_image
from correlograph.files.output import path_of
from correlograph.files.stacks import is_stack, open_stack

MAX_UNLIT_FRACTION = 0.01
"""Maximum fraction of pixels without light in the flat-field frame; they take the mean of the others."""

MIN_USED_FRACTION = 0.25
"""Minimum fraction of a frame that a mask must keep."""

COMPARED_FRAMES = 4
"""Number of frames with which a dark frame is compared."""

SMOOTH_PIXELS = 31
"""Side of the window that separates the glow of a sensor from the pattern of its pixels."""

HOT_SIGMA = 6.0
"""Deviation of a hot pixel of a dark frame in robust standard deviations."""

Source = Path | str | np.ndarray
"""A file, a stack of frames, a folder of frames, or an array (H, W) or (n, H, W)."""


@dataclass(frozen=True, eq=False)
class Corrections:
    """Calibration images of the size of the frames; None for a missing one.

    Several dark frames, in a stack, a folder or an array (n, H, W), are averaged. A dark frame has noise of its own, which would be a
    static pattern of all corrected frames. Its pixels are therefore subtracted only as far as the frames contain them.

    Attributes:
        dark: frames without light.
        flat: frame of uniform light; frames are divided by it (after subtraction of the dark frame and division by its mean).
        mask: image; where it is zero, pixels of a frame take the mean of the frame's other pixels.

    Raises InputError for anything else than files, folders and arrays.
    """

    dark: Source | None = None
    flat: Source | None = None
    mask: Source | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not isinstance(value, np.ndarray):
                path_of(name, value)

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to correct."""
        return self.dark is None and self.flat is None and self.mask is None

    @property
    def files(self) -> tuple[Path | None, ...]:
        """The files of all three, in order; None for what is missing."""
        found: list[Path | None] = []
        for value in (self.dark, self.flat, self.mask):
            is_named = value is not None and not isinstance(value, np.ndarray)
            found += files_of(Path(value)) if is_named else [None]
        return tuple(found)

    def check(self) -> None:
        """Refuse files that do not exist, before any frame is read."""
        for name, file in vars(self).items():
            if file is None or isinstance(file, np.ndarray):
                continue
            path = Path(file)
            if not (path.is_file() or (path.is_dir() and name != "mask")):
                several = "" if name == "mask" else ", or a stack or a folder of them"
                raise InputError(f"--{name}", f"an image of the frames' size{several}", f"no {path}", "check the path")

    def apply(self, capture: Capture) -> Capture:
        """Return the capture with corrected frames. Raises InputError for unsuitable files."""
        if self.is_empty:
            return capture
        change, measured = self.for_frames(capture.frames)
        if capture.measured is not None:
            measured = capture.measured if measured is None else measured & capture.measured
        if isinstance(capture.frames, FileFrames):
            return replace(capture, frames=capture.frames.map(change), measured=measured)
        return replace(capture, frames=[change(frame) for frame in capture.frames], measured=measured)

    def for_frames(self, frames: Sequence[np.ndarray]) -> tuple[Callable[[np.ndarray], np.ndarray], np.ndarray | None]:
        """Return the correction of one frame, and the pixels that keep their own value, or None for all.

        Args:
            frames: some frames (H, W), with which the dark frame is compared.
        """
        shape = frames[0].shape
        dark: np.ndarray = np.zeros((), np.float32)
        if self.dark is not None:
            first = np.mean([np.asarray(frame, np.float32) for frame in frames[:COMPARED_FRAMES]], axis=0)
            dark = _read("--dark", self.dark, shape)
            _check_level(dark, first, _name(self.dark))
            dark = pattern_in(first, dark)
        lit = used = None
        gain = np.float32(1.0)
        if self.flat is not None:
            flat = _read("--flat", self.flat, shape) - dark
            lit = flat > 0.0  # a pixel that is saturated in the dark frame is not
            if lit.mean() < 1.0 - MAX_UNLIT_FRACTION:
                raise InputError(
                    "--flat",
                    f"more light than the dark frame holds in all but {MAX_UNLIT_FRACTION:.0%} of the pixels",
                    f"{1.0 - lit.mean():.1%} without in {_name(self.flat)}",
                    "use flat and dark frames of one exposure",
                )
            gain = np.where(lit, flat, flat[lit].mean()) / flat[lit].mean()
        if self.mask is not None:
            used = _read("--mask", self.mask, shape) != 0.0
            if used.mean() < MIN_USED_FRACTION:
                raise InputError(
                    "--mask",
                    f"a mask that leaves {MIN_USED_FRACTION:.0%} of the pixels",
                    f"{used.mean():.1%} in {_name(self.mask)}",
                    "zero pixels are left out; turn it round",
                )

        masks = [mask for mask in (lit, used) if mask is not None]
        return partial(_correct, dark, lit, gain, used), np.logical_and.reduce(masks) if masks else None


def _check_level(dark: np.ndarray, frame: np.ndarray, name: str) -> None:
    """Raise InputError for a dark frame that is brighter than a frame by more than the standard deviation of its pixels."""
    own, seen = float(np.median(dark)), float(np.median(frame))
    if own > seen + float(frame.std()):
        expected, found = "no more light than the frames have", f"a median of {own:.4g} in {name}, {seen:.4g} in the frames"
        raise InputError("--dark", expected, found, "take it at the exposure and gain of the frames, and subtract it once")


def pattern_in(frame: np.ndarray, dark: np.ndarray) -> np.ndarray:
    """Return the part of a dark frame (H, W) that a frame (H, W) contains.

    The dark frame is split into glow, which is smoother than `SMOOTH_PIXELS`, lines, pixels and hot pixels. Lines and pixels are
    multiplied by their regression coefficient b = cov(frame, dark) / var(dark). For a fixed pattern of variance s^2 and a noise v of the
    dark frame, b is s^2 / (s^2 + v), and the variance that the subtraction leaves in all frames is s^2 v / (s^2 + v), less than either.
    """
    deviation = dark - np.median(dark)
    spread = 1.4826 * float(np.median(np.abs(deviation))) or float(deviation.std())
    hot = np.abs(deviation - uniform_filter(np.clip(deviation, -HOT_SIGMA * spread, HOT_SIGMA * spread), SMOOTH_PIXELS)) > (
        HOT_SIGMA * max(spread, 1e-30)
    )
    calm = np.where(hot, np.median(dark), dark)
    glow = uniform_filter(calm, SMOOTH_PIXELS, mode="nearest")
    seen = np.where(hot, np.median(frame), frame)
    seen = seen - uniform_filter(seen, SMOOTH_PIXELS, mode="nearest")
    rest, kept = calm - glow, glow
    for axis in (1, 0, None):
        part = rest if axis is None else np.broadcast_to(rest.mean(axis, keepdims=True), rest.shape)
        kept = kept + _coefficient(seen if axis is None else seen.mean(axis), part if axis is None else part.mean(axis)) * part
        rest = rest - part
    return np.where(hot, dark, kept).astype(np.float32)


def _coefficient(frame: np.ndarray, dark: np.ndarray) -> float:
    """Return the regression coefficient of a frame on a part of the dark frame, between 0 and 1; 1 if it is compatible with 1."""
    frame, dark = (np.asarray(values, np.float64).ravel() - float(values.mean(dtype=np.float64)) for values in (frame, dark))
    power = float(dark @ dark)
    if power == 0.0:
        return 0.0
    found = float(frame @ dark) / power
    error = float(frame.std()) / power**0.5
    return 1.0 if abs(found - 1.0) < 3.0 * error else min(max(found, 0.0), 1.0)


def files_of(path: Path) -> list[Path]:
    """Return the files of frames of a path: those in a folder, or the path itself."""
    return list(frames_inside(path)) if path.is_dir() and not is_stack(path) else [path]


def _correct(
    dark: np.ndarray, lit: np.ndarray | None, gain: np.ndarray, used: np.ndarray | None, frame: np.ndarray
) -> np.ndarray:
    """Return a frame minus the dark frame, divided by the gain, with the mean in pixels that are not lit or not used."""
    frame = frame - dark
    if lit is not None:
        frame = np.where(lit, frame, frame[lit].mean()) / gain
    if used is not None:
        frame = np.where(used, frame, frame[used].mean())
    return frame.astype(np.float32, copy=False)


def _read(option: str, source: Source, shape: tuple[int, ...]) -> np.ndarray:
    """Return an image, or the mean of several."""
    if isinstance(source, np.ndarray):
        images = source[None] if source.ndim == 2 else source
        if images.ndim != 3 or len(images) == 0 or images.dtype.kind not in "uifb":
            raise InputError(option, "an array (H, W) or (n, H, W) of numbers", f"{source.dtype} {source.shape}", "convert it")
        named = [(image.astype(np.float32), "the array") for image in images]
    else:
        named = _images(option, Path(source))
    total = np.zeros(shape)
    for pixels, name in named:
        if not np.isfinite(pixels).all():
            raise InputError(option, "finite pixels", f"NaN or infinity in {name}", "use another file")
        if pixels.shape != shape:
            raise InputError(option, f"the frames' size {shape}", f"{pixels.shape} in {name}", "use another file")
        total += pixels
    return (total / len(named)).astype(np.float32)


def _images(option: str, path: Path) -> list[tuple[np.ndarray, str]]:
    """Return the images of a file, stack or folder with their names; several only for dark and flat frames."""
    if not (path.is_file() or path.is_dir() or is_stack(path)):
        raise InputError(option, "an image, a stack or a folder of them", f"no {path}", "check the path")
    files = files_of(path)
    if not files:
        raise InputError(option, "a folder with frames", f"none in {path}", "check the folder")
    if option == "--mask":
        return [(read_image(path, booleans=True)[0], path.name)]
    stacks = [open_stack(file) for file in files]
    return [(as_frame(stack.read(number)[0], stack.path), stack.path.name) for stack in stacks for number in range(stack.count)]


def _name(source: Source) -> str:
    return "the array" if isinstance(source, np.ndarray) else Path(source).name
