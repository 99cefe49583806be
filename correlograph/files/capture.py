"""A capture: frames of one scene and the metadata of their camera; the interface between `sim` and `invert`."""

from __future__ import annotations

import json
from collections.abc import Sequence, Sized
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from correlograph.errors import InputError, check_positive
from correlograph.files.capture_folder import check_complete, frame_path, replace_capture, stage_capture
from correlograph.files.exr_frames import FrameHeader, read_frame, write_frame
from correlograph.files.figures import add_scale_bar, figure_as_html, show_figure
from correlograph.files.file_frames import FileFrames
from correlograph.files.file_metadata import FileMetadata, rendered_metadata
from correlograph.files.output import output_folder, path_of, save_array, save_json
from correlograph.lags import LAG_SIDE
from correlograph.ranges import FRAMES, WAVELENGTH

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_PLOTTED_FRAMES = 3


@dataclass(frozen=True)
class CameraMetadata:
    """Metadata of a capture; None for unknown values. Lengths in metres; `pixel_pitch_m` is the pitch on a virtual detector
    perpendicular to the axis of the camera.

    `row_pitch_m` and `column_pitch_m` differ from it if camera or wall are tilted.
    """

    wavelength_m: float | None = None
    pixel_pitch_m: float | None = None
    distance_m: float | None = None
    pupil_diameter_m: float | None = None
    pupil_distance_m: float | None = None
    row_pitch_m: float | None = None
    column_pitch_m: float | None = None

    def __post_init__(self) -> None:
        """Raise InputError for a value that is not a positive number, and for values that contradict each other."""
        for name, value in vars(self).items():
            if value is not None:
                object.__setattr__(self, name, check_positive(name, value))
        if self.wavelength_m is not None:
            WAVELENGTH.check("wavelength_m", self.wavelength_m)
        if self.wavelength_m is not None and self.pixel_pitch_m is not None and self.pixel_pitch_m < 0.5 * self.wavelength_m:
            found = f"{self.pixel_pitch_m:.3g} m for a wavelength of {self.wavelength_m:.3g} m"
            raise InputError(
                "pixel_pitch_m", "half a wavelength or more, in metres on the wall", found, "check whether the two are swapped"
            )
        if (
            self.distance_m is not None
            and self.pixel_pitch_m is not None
            and self.pixel_pitch_m * LAG_SIDE > 2.0 * self.distance_m
        ):
            found = f"{self.pixel_pitch_m:.3g} m at a distance of {self.distance_m:.3g} m"
            remedy = "give all lengths in metres; no object could be resolved to half a wavelength"
            raise InputError("pixel_pitch_m", f"at most {2.0 * self.distance_m / LAG_SIDE:.3g} m", found, remedy)

    def check_complete(self) -> None:
        """Raise InputError if only some of wavelength, pixel pitch and distance are known, or one length of the pupil."""
        for names in (("wavelength_m", "pixel_pitch_m", "distance_m"), ("pupil_diameter_m", "pupil_distance_m")):
            lacking = [name for name in names if getattr(self, name) is None]
            if 0 < len(lacking) < len(names):
                options = ", ".join("--" + name.replace("_", "-") for name in lacking)
                raise InputError(
                    "camera metadata", f"{', '.join(names)} together", f"no {', '.join(lacking)}", f"add {options}"
                )

    @property
    def field_m(self) -> float | None:
        """Widest object whose speckle the pixels resolve, lambda z / (2 pitch); None if the camera is unknown."""
        if self.lag_geometry is None:
            return None
        wavelength, distance, pitches = self.lag_geometry
        return 0.5 * wavelength * distance / max(pitches)

    @property
    def lag_geometry(self) -> tuple[float, float, tuple[float, float]] | None:
        """(wavelength, distance, pitches of rows and of columns as the object sees them); None unless all are known."""
        if self.wavelength_m is None or self.distance_m is None or self.pixel_pitch_m is None:
            return None
        pitches = self.row_pitch_m or self.pixel_pitch_m, self.column_pitch_m or self.pixel_pitch_m
        return self.wavelength_m, self.distance_m, pitches

    @classmethod
    def of(cls, header: FrameHeader | None) -> CameraMetadata:
        """Return the metadata of a frame's header in the single precision of its file, so that memory and file give
        equal results."""
        if header is None:
            return cls()
        values = (
            header.wavelength_m,
            header.pixel_pitch_m,
            header.distance_m,
            header.pupil_diameter_m,
            header.pupil_distance_m,
            header.row_pitch_m,
            header.column_pitch_m,
        )
        return cls(*(None if value is None else float(np.float32(value)) for value in values))


CameraFacts = CameraMetadata
"""Old name of `CameraMetadata`."""


def check_unmasked(frames: object) -> None:
    """Raise InputError for a masked array, or a list with one, some of whose pixels are masked."""
    every = frames if isinstance(frames, (list, tuple)) else [frames]
    if any(isinstance(one, np.ma.MaskedArray) and np.ma.is_masked(one) for one in every):
        raise InputError("frames", "arrays without a mask", "masked pixels", "provide the mask as corrections")


def _as_native(frames: Sequence[np.ndarray]) -> Sequence[np.ndarray]:
    """Return frames in the byte order of the machine and without reversed axes; the same object if all are so already."""
    if all(frame.dtype.isnative and min(frame.strides) >= 0 for frame in frames):
        return frames
    return [np.ascontiguousarray(frame, frame.dtype.newbyteorder("=")) for frame in frames]


@dataclass(frozen=True)
class Capture:
    """Frames of one capture.

    Attributes:
        frames: each float32 (H, W).
        camera: metadata of the camera.
        names: names of the frames, or of the files that hold them.
        truth: albedo of the hidden object on the lag grid, (64, 64), for rendered frames.
        record: content of `sim.json` for rendered frames, including the plan.
        headers: headers of rendered frames.
        file_metadata: exposure, gain and other values that the first file states.
        measured: pixels (H, W) that hold their own value, bool; the others were masked, and hold a mean. None for all.
    """

    frames: Sequence[np.ndarray]
    camera: CameraMetadata = CameraMetadata()
    names: tuple[str, ...] = ()
    truth: np.ndarray | None = None
    record: dict[str, Any] = field(default_factory=dict)
    headers: tuple[FrameHeader, ...] = ()
    file_metadata: FileMetadata = field(default_factory=FileMetadata)
    measured: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Raise InputError for no frames, for frames of several sizes or with channels, and for incomplete metadata."""
        if not isinstance(self.camera, CameraMetadata):
            raise InputError(
                "camera", "a CameraMetadata", f"{self.camera!r:.60}", "create one with correlograph.CameraMetadata"
            )
        self.camera.check_complete()
        if not isinstance(self.names, (tuple, list)) or not all(isinstance(name, str) for name in self.names):
            raise InputError("names", "a tuple of names", f"{self.names!r:.60}", "name the files or frames")
        if isinstance(self.frames, Sized) and len(self.names) > max(1, len(self.frames)):
            found = f"{len(self.names)} for {len(self.frames)} frames"
            raise InputError("names", "at most one for each frame", found, "select names and frames alike, or omit the names")
        if isinstance(self.frames, FileFrames):  # they are checked when they are read
            return
        if not isinstance(self.frames, (Sequence, np.ndarray)) or isinstance(self.frames, str):
            raise InputError("frames", "a list or an array of frames", f"{self.frames!r:.60}", "provide frames")
        if len(self.frames) == 0:
            raise InputError("frames", "one or more", "none", "provide frames of shape (height, width)")
        check_unmasked(self.frames)
        if not all(isinstance(frame, np.ndarray) and frame.dtype.kind in "uif" for frame in self.frames):
            found = ", ".join(dict.fromkeys(str(getattr(frame, "dtype", type(frame).__name__)) for frame in self.frames))
            raise InputError("frames", "arrays of real numbers", found, "convert them to float32")
        shapes = list(dict.fromkeys(np.shape(frame) for frame in self.frames))
        if len(shapes) > 1 or len(shapes[0]) != 2:
            raise InputError("frames", "frames (height, width) of one size", f"shapes {shapes}", "provide one camera setting")
        object.__setattr__(self, "frames", _as_native(self.frames))

    def __repr__(self) -> str:
        height, width = np.shape(self.frames[0])
        exposure = f", {self.headers[0].exposure_s:g} s" if self.headers else ""
        return f"Capture({len(self.frames)} frames of {height} x {width} pixels{exposure})"

    def _repr_html_(self) -> str:
        return figure_as_html(self.plot(), repr(self))

    def plot(self) -> Figure:
        """Return the first frames as a matplotlib figure."""
        from matplotlib.figure import Figure

        shown = list(self.frames[:MAX_PLOTTED_FRAMES])
        figure = Figure(figsize=(4.2 * len(shown), 3.6), layout="constrained")
        names = self.names or tuple(f"frame {number}" for number in range(len(shown)))
        for axes, frame, name in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, names, strict=False):
            image = axes.imshow(frame, cmap="gray", vmin=0.0, vmax=float(np.quantile(frame, 0.999)) or 1.0)
            axes.set_title(name, fontsize=9, parse_math=False)
            axes.set_xlabel("pixels", fontsize=8)
            figure.colorbar(image, ax=axes, shrink=0.8, label="photoelectrons" if self.headers else "grey value")
            if self.camera.pixel_pitch_m is not None:
                add_scale_bar(axes, self.camera.pixel_pitch_m, frame.shape[1], frame.shape[0])
        return figure

    def show(self) -> None:
        """Open the first frames in a window, or below a notebook cell."""
        show_figure(self.plot())

    @classmethod
    def load(cls, folder: str | Path) -> Capture:
        """Load a rendered capture with its truth and its record, or frames of a camera without metadata.

        Args:
            folder: folder that `python -m sim` wrote, a folder of frames, or a file of one frame or several.

        Raises InputError for anything else.
        """
        path = path_of("capture", folder)
        if not path.exists():
            raise InputError("capture", "a folder or file of frames", f"no {path}", "check the path")
        if not (path / "sim.json").is_file() and not (path / "truth.npy").exists():
            from correlograph.files.captured_frames import read_capture

            return read_capture([path], CameraMetadata())
        check_complete(path)
        try:
            record = json.loads((path / "sim.json").read_text())
            truth = np.load(path / "truth.npy", allow_pickle=False)
            files = [frame_path(path, number) for number in range(FRAMES.check("frames of sim.json", record["frames"]))]
            missing = next((file for file in files if not file.is_file()), None)
            if missing is not None:
                raise InputError("capture", "every frame that sim.json lists", f"no {missing}", "render the capture again")
            read = [read_frame(file) for file in files if file.is_file()]
        except (OSError, ValueError, KeyError, TypeError, EOFError, RecursionError) as error:
            if isinstance(error, InputError):
                raise
            found = f"{type(error).__name__} in {path}"
            raise InputError("capture", "a folder that python -m sim wrote", found, "check the path") from None
        if truth.ndim != 2 or truth.dtype.kind != "f" or not np.isfinite(truth).all():
            raise InputError(
                "capture", "a truth of finite numbers", f"{truth.dtype} {truth.shape} in {path}", "render it again"
            )
        headers = tuple(header for _, header in read if header is not None)
        if len(read) < len(files) or len(headers) < len(read):
            found = f"{len(headers)} frames of {len(files)} in {path}"
            raise InputError("capture", "every frame that sim.json lists", found, "render the capture again")
        names = tuple(file.stem for file in files)
        written = rendered_metadata(headers[0].exposure_s)
        return cls([pixels for pixels, _ in read], CameraMetadata.of(headers[0]), names, truth, record, headers, written)

    @property
    def plan(self) -> dict[str, Any] | None:
        """The plan of rendered frames, None for captured ones."""
        return self.record.get("plan")

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write rendered frames with truth.npy and sim.json, as `python -m sim` does.

        Args:
            overwrite: whether to replace files of these names that this program did not write.

        Raises InputError for captured frames, and for such files without `overwrite`.
        """
        if len(self.headers) != len(self.frames) or self.truth is None:
            raise InputError("capture", "frames that were rendered", "captured ones", "their files are elsewhere already")
        target = output_folder(folder)
        with stage_capture(target, len(self.frames), overwrite=overwrite) as staging:
            for number, (frame, header) in enumerate(zip(self.frames, self.headers, strict=True)):
                write_frame(frame_path(staging, number), frame, header)
            save_array(staging / "truth.npy", self.truth)
            save_json(staging / "sim.json", self.record)
            replace_capture(staging, target)
        return target
