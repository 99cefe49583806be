"""Path of a hidden object, from which its velocity and vibrations follow, with table and plot."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from correlograph.files.figures import figure_as_html
from invert.tracking.numbers import missing_frames
from invert.tracking.smoothing import PathNoise, error_in_groups, smooth
from invert.tracking.tables import save_table
from invert.tracking.vibration import find_vibrations

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRACK_FILES = ("track.csv", "track.png", "track.json")

MAX_SHORTENED = 0.2
"""Part by which an open shutter shortens a step, above which the path is doubtful: a change of the step then shows by 0.6 of it only."""


MIN_GRAINS = 700.0
"""Grains in a frame of the speckle of one of several objects, below which interference makes paths unreliable. Evidence:
docs/tracking_measured.md."""

STILL_SIGMA, STILL_PIXELS = 3.0, 0.5
"""Standard errors that the path of a pattern at rest exceeds in no frame, and pixels that it may have whatever its error. The rms of its
path does not exceed that of its errors, either, so that a path that is not well known is not one at rest."""


@dataclass(frozen=True)
class Track:
    """Motion of the speckle of one object over the wall, and of the object if its geometry is known.

    Attributes:
        path_pixels: position of the speckle in each frame in camera pixels (rows, columns), (frames, 2), from the first frame.
        error_pixels: standard error of each position of the speckle, (frames, 2). What the illumination adds is in `error_m`.
        significance: significance of the common motion, in standard deviations.
        share: share of the power of the speckle that frames have in common by this object: consecutive ones, or, of several objects,
            those 2 to 32 apart by which it was found.
        frames_per_position: number of frames that were registered together, for lack of light.
        metres_per_pixel: displacement of the object (rows, columns) per pixel of its speckle, (2, 2); None if its geometry is unknown.
        interval_s: time between frames; None if unknown.
        others: tracks of further objects, the brightest first.
        noise: noise of the path; of variance zero if unknown.
        in_common: share of the power of the speckle that frames 1, 2, ... apart have in common by this object, (at most 16,); empty for a
            single object.
        stretch: standard deviation of what the illumination adds to a displacement of the speckle, in pixels (rows, columns) per metre
            of the object's displacement, (2,); None if the geometry is unknown.
        fading: distance of frames, and part of what consecutive frames share that frames so far apart share along the path of a single
            object: the first power of two at which this is clearly less than half, or else the largest distance that is compared; 1,
            and the share of all their speckle, if only this is low; None if neither leaves room for another object, or three standard
            errors do.
        shortened: largest part by which the open shutter shortens a step; corrected, but not well if large.
        numbers: number of each frame from the first, (frames,), of which files may be missing; None if frames are counted.
        order: doubts about the order of the frames.
        interpolated: frames that share nothing with those beside them, whose positions are interpolated.
        grains: number of grains of its speckle in a frame.
    """

    path_pixels: np.ndarray
    error_pixels: np.ndarray
    significance: float
    share: float
    frames_per_position: int = 1
    metres_per_pixel: np.ndarray | None = None
    interval_s: float | None = None
    others: tuple[Track, ...] = ()
    noise: PathNoise = field(default_factory=PathNoise)
    in_common: np.ndarray = field(default_factory=lambda: np.zeros(0))
    stretch: np.ndarray | None = None
    fading: tuple[int, float] | None = None
    shortened: float = 0.0
    numbers: np.ndarray | None = None
    interpolated: tuple[int, ...] = ()
    order: tuple[str, ...] = ()
    grains: float = np.inf

    @property
    def frame_numbers(self) -> np.ndarray:
        """Number of each frame from the first, (frames,), with those that are missing."""
        return np.arange(len(self.path_pixels)) if self.numbers is None else self.numbers

    @property
    def warnings(self) -> tuple[str, ...]:
        """Doubts about the path, in words."""
        doubts = [*missing_frames(self.frame_numbers), *self.order]
        if self.interpolated:
            doubts.append(self.of_strange_frames)
        if self.is_at_rest:
            doubts.append(
                "this pattern stays at rest: static light, a texture of the wall or a pattern of the sensor does so, too, and may hide an "
                "object that moves (--dark, --flat)"
            )
        if len(self.in_common) and self.grains < MIN_GRAINS:
            doubts.append(
                f"several objects interfere, and a frame holds only {self.grains:.0f} grains of the speckle of this one: one in four of "
                "such paths is wrong by more than four stated errors (docs/tracking_measured.md); take larger frames"
            )
        if self.shortened > MAX_SHORTENED:
            doubts.append(
                f"the open shutter shortens steps by up to {100.0 * self.shortened:.0f} %; such steps are corrected by a rough estimate: "
                "shorten the exposure"
            )
        if self.fading is not None:
            apart, part = self.fading
            shared = f"frames {apart} apart share {100.0 * part:.0f} % of what consecutive ones share"
            if apart == 1:
                shared = f"consecutive frames share {100.0 * part:.0f} % of their speckle"
            doubts.append(
                f"{shared}: the illumination of the object changes, or several objects have not moved apart by a grain of their speckle, "
                "and this path lies between theirs"
            )
        return tuple(doubts)

    @property
    def is_at_rest(self) -> bool:
        """Whether the speckle stays at its place: by the error of its path in each frame, and by the mean square of all."""
        path, error = np.abs(self.smooth_path_pixels), self.error_pixels
        rms, rms_error = (np.sqrt((one**2).mean(0)) for one in (path, error))
        is_near = (path <= np.maximum(STILL_PIXELS, STILL_SIGMA * error)).all()
        return bool(is_near and (rms <= np.maximum(STILL_PIXELS, rms_error)).all())

    @property
    def interpolated_numbers(self) -> list[int]:
        """Numbers of the frames whose positions are interpolated."""
        return [int(self.frame_numbers[index]) for index in self.interpolated]

    @property
    def of_strange_frames(self) -> str:
        """The frames whose positions are interpolated, in words."""
        numbers = self.interpolated_numbers
        named = ", ".join(map(str, numbers[:10])) + (", ..." if len(numbers) > 10 else "")
        return f"frames that share nothing with those beside them, whose positions are interpolated: {named}"

    @property
    def bend_error_pixels(self) -> np.ndarray:
        """Standard error of a second difference of the path by noise, (2,); zero if unknown."""
        return self.noise.bend_error

    @property
    def smooth_path_pixels(self) -> np.ndarray:
        """The path without what noise bends it by, (frames, 2). Vibrations below the noise are smoothed, too."""
        return smooth(self.path_pixels, self.noise)

    def error_in_groups(self, size: int) -> tuple[float, float]:
        """Return the rms standard error of the smoothed path about its means over groups of some frames, in pixels (rows, columns).

        That of an approximate path is half of the error of the last position of a group from the first.
        """
        size = min(size, len(self.path_pixels))
        is_known = self.noise.of_pair.any()
        rows, columns = error_in_groups(self.path_pixels, self.noise, size) if is_known else 0.5 * self.error_pixels[size - 1]
        return float(rows), float(columns)

    @property
    def step_pixels(self) -> np.ndarray:
        """Mean displacement from frame to frame (2,)."""
        return (self.path_pixels[-1] - self.path_pixels[0]) / self.frame_numbers[-1]

    @property
    def step_error_pixels(self) -> np.ndarray:
        """Standard error of the mean displacement, (2,)."""
        return self.error_pixels[-1] / self.frame_numbers[-1]

    @property
    def path_m(self) -> np.ndarray | None:
        """Position of the object in each frame in metres, (frames, 2), along the axes of the frame."""
        return None if self.metres_per_pixel is None else self.path_pixels @ self.metres_per_pixel.T

    @property
    def error_m(self) -> np.ndarray | None:
        """Standard error of each position of the object in metres, (frames, 2): that of its speckle and, in proportion to the distance from
        the first frame, what the speckle of the illumination adds (`to_object.py`). It is too large for ways beyond the width of the
        object's strokes."""
        path = self.path_m
        if path is None or self.metres_per_pixel is None or self.stretch is None:
            return None
        by_illumination = np.linalg.norm(path, axis=1)[:, None] * self.stretch
        return np.sqrt((self.error_pixels**2 + by_illumination**2) @ (self.metres_per_pixel**2).T)

    @property
    def velocity_m_s(self) -> np.ndarray | None:
        """Mean velocity of the object (2,)."""
        if self.metres_per_pixel is None or self.interval_s is None:
            return None
        return self.metres_per_pixel @ self.step_pixels / self.interval_s

    @property
    def velocity_error_m_s(self) -> np.ndarray | None:
        """Standard error of the mean velocity of the object, (2,)."""
        error = self.error_m
        if error is None or self.interval_s is None:
            return None
        return error[-1] / (self.frame_numbers[-1] * self.interval_s)

    @property
    def vibrations(self) -> list[dict[str, Any]]:
        """Periodic parts of the path: periods per frame and, if the geometry is known, hertz and metres (rows, columns).

        They are sought in the longest part of the path without a missing frame.
        """
        gaps = np.flatnonzero(np.diff(self.frame_numbers) > 1) + 1
        found = []
        for one in find_vibrations(max(np.split(self.path_pixels, gaps), key=len)):
            told: dict[str, Any] = {"periods_per_frame": one.periods_per_frame, "amplitude_pixels": list(one.amplitude_pixels)}
            if self.interval_s is not None:
                told["hz"] = one.periods_per_frame / self.interval_s
            if self.metres_per_pixel is not None:
                told["amplitude_m"] = np.abs(self.metres_per_pixel @ one.phasor_pixels).tolist()
            found.append(told | {"false_alarm": one.false_alarm})
        return found

    def __repr__(self) -> str:
        rows, columns = self.step_pixels
        speed = self.velocity_m_s
        known = "" if speed is None else f", object {speed[0] * 1e3:.4g} and {speed[1] * 1e3:.4g} mm/s"
        more = f", {len(self.others)} more" if self.others else ""
        return (
            f"Track({len(self.path_pixels)} frames, {rows:.3f} and {columns:.3f} pixels per frame{known}, "
            f"{self.significance:.0f} sigma{more})"
        )

    def _repr_html_(self) -> str:
        return figure_as_html(self.plot(), repr(self))

    def plot(self) -> Figure:
        """Return the paths as a matplotlib figure."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5.0, 4.2), layout="constrained")
        axes = figure.add_subplot()
        unit, kind = ("pixels", "speckle on the wall") if self.path_m is None else ("mm", "object")
        for number, one in enumerate((self, *self.others), 1):
            path = one.path_pixels if one.path_m is None else 1e3 * one.path_m
            label = f"{number}, {100 * one.share:.0f} % in common" if self.others else None
            (line,) = axes.plot(path[:, 1], path[:, 0], ".-", linewidth=0.8, markersize=4, label=label)
            axes.plot(
                path[:1, 1], path[:1, 0], "o", mfc="none", color=line.get_color(), label=None if self.others else "first frame"
            )
        axes.set(xlabel=f"columns ({unit})", ylabel=f"rows ({unit})", title=f"path of the {kind}", aspect="equal")
        axes.set_adjustable("datalim")
        axes.invert_yaxis()
        axes.legend(frameon=False)
        return figure

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON, without the path."""
        speed, speed_error, lever = self.velocity_m_s, self.velocity_error_m_s, self.metres_per_pixel
        return {
            "frames": len(self.path_pixels),
            "step_pixels": self.step_pixels.tolist(),
            "step_error_pixels": self.step_error_pixels.tolist(),
            "significance": self.significance,
            "share": self.share,
            "frames_per_position": self.frames_per_position,
            "metres_per_pixel": None if lever is None else lever.tolist(),
            "interval_s": self.interval_s,
            "velocity_m_s": None if speed is None else speed.tolist(),
            "velocity_error_m_s": None if speed_error is None else speed_error.tolist(),
            "vibrations": self.vibrations,
            "interpolated": self.interpolated_numbers,
            "warnings": list(self.warnings),
            "others": [one.as_dict() for one in self.others],
        }

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns of the table of positions: frame, seconds if known, and for each object pixels, errors and metres."""
        table: dict[str, np.ndarray] = {"frame": self.frame_numbers}
        if self.interval_s is not None:
            table["time_s"] = self.frame_numbers * self.interval_s
        for number, one in enumerate((self, *self.others), 1):
            suffix = "" if number == 1 else f"_{number}"
            named = {"pixels": one.path_pixels, "error_pixels": one.error_pixels}
            in_metres = {"m": one.path_m, "error_m": one.error_m}
            named |= {unit: values for unit, values in in_metres.items() if values is not None}
            for unit, values in named.items():
                table |= {f"{axis}_{unit}{suffix}": values[:, index] for index, axis in enumerate(("row", "column"))}
        return table

    def save(self, folder: str | Path) -> Path:
        """Write track.csv, track.json and track.png; return the folder."""
        return save_table(folder, TRACK_FILES, (self.columns(), self.as_dict(), self.plot()))
