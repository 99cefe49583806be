"""Rotation of a hidden object and change of its distance over the frames of a capture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from correlograph.errors import InputError, check_positive
from correlograph.files.capture import Capture
from correlograph.files.figures import figure_as_html, save_figure
from correlograph.files.output import atomic, output_folder, save_json, sole_writer
from correlograph.lags import LAGS
from invert.measure.estimate import estimate_from_frames
from invert.measure.spectrum import read_measurement
from invert.request import Request
from invert.tracking.rings import Turns, find_turns, group_means

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MIN_ANGLES = 4
"""Minimum number of angles, each of two halves of at least one frame."""

MAX_ERROR_DEG = 3.0
"""Standard error of an angle above which the autocorrelations of more frames are averaged."""

MIN_SIGMA = 5.0
"""Minimum correlation of consecutive groups in standard deviations; among fifty pairs and fifty angles, chance exceeds it with a
probability of 0.001."""

ROTATION_FILES = ("rotation.csv", "rotation.png", "rotation.json")


@dataclass(frozen=True)
class Rotation:
    """Rotation of an object about the line of sight, and its distance from the wall.

    Attributes:
        angle_deg: angle of each group of frames from the first one, (groups,), anticlockwise in the pictures of the albedo.
        distance_ratio: distance over that of the first group, (groups,).
        angle_error_deg, distance_error: standard errors of a difference between two groups.
        frames_per_angle: number of frames in a group.
        interval_s: time between frames; None if unknown.
    """

    angle_deg: np.ndarray
    distance_ratio: np.ndarray
    angle_error_deg: float
    distance_error: float
    frames_per_angle: int
    interval_s: float | None = None

    @classmethod
    def of(cls, turns: Turns, frames_per_angle: int, interval_s: float | None) -> Rotation:
        """Return the rotation from the turns of both halves of each group: means, and errors from the differences between the halves.

        The illumination's speckle changes r*r at many lags at once, so that residuals within one group do not show its errors.
        """
        halves = np.stack([np.degrees(turns.angle), -np.log(turns.scale)])
        halves = halves[:, : halves.shape[1] // 2 * 2].reshape(2, -1, 2)
        angle, distance = halves.mean(2) - halves.mean(2)[:, :1]
        errors = np.diff(halves, axis=2)[..., 0].std(1, ddof=1) / np.sqrt(2.0)
        return cls(angle, np.exp(distance), float(errors[0]), float(errors[1]), frames_per_angle, interval_s)

    @property
    def middle_frame(self) -> np.ndarray:
        """Number of the frame in the middle of each group, (groups,)."""
        return self.frames_per_angle * (np.arange(len(self.angle_deg)) + 0.5) - 0.5

    def __repr__(self) -> str:
        return (
            f"Rotation({len(self.angle_deg)} groups of {self.frames_per_angle} frames, {self.angle_deg[-1]:.1f} +- "
            f"{self.angle_error_deg:.1f} degrees, distance times {self.distance_ratio[-1]:.3f} +- {self.distance_error:.3f})"
        )

    def _repr_html_(self) -> str:
        return figure_as_html(self.plot(), repr(self))

    def plot(self) -> Figure:
        """Return angle and distance as a matplotlib figure."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5.6, 5.0), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True)
        known = self.interval_s is not None
        place = self.middle_frame * (self.interval_s if known else 1.0)
        upper.errorbar(place, self.angle_deg, self.angle_error_deg, fmt=".-", capsize=2)
        upper.set_ylabel("angle (degrees)")
        lower.errorbar(place, self.distance_ratio, self.distance_error, fmt=".-", capsize=2)
        lower.set(xlabel="time (s)" if known else "frame", ylabel="distance / first distance")
        return figure

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON, without the list of angles."""
        rate = None if self.interval_s is None else float(np.polyfit(self.middle_frame * self.interval_s, self.angle_deg, 1)[0])
        return {
            "groups": len(self.angle_deg),
            "frames_per_angle": self.frames_per_angle,
            "interval_s": self.interval_s,
            "turn_deg": float(self.angle_deg[-1]),
            "angle_error_deg": self.angle_error_deg,
            "mean_rate_deg_per_s": rate,
            "distance_ratio": float(self.distance_ratio[-1]),
            "distance_error": self.distance_error,
        }

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns of the table: middle frame, seconds if known, angle and distance."""
        table = {"frame": self.middle_frame}
        if self.interval_s is not None:
            table["time_s"] = self.middle_frame * self.interval_s
        return table | {"angle_deg": self.angle_deg, "distance_ratio": self.distance_ratio}

    def save(self, folder: str | Path) -> Path:
        """Write rotation.csv, rotation.json and rotation.png; return the folder."""
        target, table = output_folder(str(folder)), self.columns()
        with sole_writer(target):
            with atomic(target / "rotation.csv") as partial:
                np.savetxt(partial, np.column_stack([*table.values()]), "%.9g", ",", header=",".join(table), comments="")
            save_figure(target / "rotation.png", self.plot())
            save_json(target / "rotation.json", self.as_dict())
        return target


def track_rotation(capture: Capture, *, interval_s: float | None = None) -> Rotation:
    """Find the rotation of the object about the line of sight and the change of its distance.

    The laser may be at rest or not. The autocorrelations of consecutive frames are averaged in groups of two halves, as short as the light
    permits. The object must turn by less than a quarter from one half to the next.

    Raises InputError for too few frames or too little light, and for objects that look alike at every angle.
    """
    if interval_s is not None:
        check_positive("interval_s", interval_s)
    if not isinstance(capture, Capture):
        raise InputError("capture", "a Capture", f"{capture!r:.60}", "load it with correlograph.Capture.load")
    count = len(capture.frames)
    if count < 2 * MIN_ANGLES:
        raise InputError("frames", f"{2 * MIN_ANGLES} or more for a rotation", count, "provide more frames")
    signals, aspect = _signals(capture)
    size = 1
    while count // (2 * size) >= MIN_ANGLES:
        turns = find_turns(group_means(signals, size), aspect)
        found = Rotation.of(turns, 2 * size, interval_s)
        if turns.significance >= MIN_SIGMA and found.angle_error_deg <= MAX_ERROR_DEG:
            return found
        size *= 2
    expected = f"an autocorrelation whose angle is known to {MAX_ERROR_DEG:g} degrees"
    raise InputError("frames", expected, f"none in {MIN_ANGLES} groups", "add light or frames; a round object shows no angle")


def _signals(capture: Capture) -> tuple[list[np.ndarray], float]:
    """Return r*r of each frame without floor, (127, 127) each, and the pitch of its lags along rows over that along columns."""
    signals, aspect = [], 1.0
    for frame in tqdm(capture.frames, desc="autocorrelations", unit="frame", disable=None, leave=False):
        estimate = estimate_from_frames(replace(capture, frames=[frame], names=()), Request(lags=LAGS))
        measurement = read_measurement(estimate.values, estimate.quantisation, estimate.transfer)
        signals.append(measurement.values - measurement.noise.floor)
        if estimate.pitches_m is not None:
            aspect = estimate.pitches_m[0] / estimate.pitches_m[1]
    return signals, aspect
