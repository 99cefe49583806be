"""Rotation of a hidden object and change of its distance over the frames of a capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import interp1d
from tqdm import tqdm

from correlograph.errors import InputError
from correlograph.files.capture import Capture
from correlograph.files.captured_frames import check_frames_in_memory
from correlograph.files.figures import figure_as_html
from correlograph.lags import LAGS
from invert.measure.estimate import estimate_from_frames
from invert.measure.spectrum import read_measurement
from invert.request import Request
from invert.tracking.numbers import doubts_of_order, frame_numbers, missing_frames
from invert.tracking.pursuit import MIN_SHARE
from invert.tracking.rings import Turns, find_turns, group_means
from invert.tracking.tables import check_frames, save_table
from invert.tracking.travel import common_share

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MIN_ANGLES = 4
"""Minimum number of angles, each of two halves of at least one frame."""

MAX_HALVES = 128
"""Maximum number of halves of groups; the time grows with its square."""

MAX_ERROR_DEG = 3.0
"""Standard error of an angle above which the autocorrelations of more frames are averaged."""

MIN_SIDE = 4 * LAGS + 2
"""Minimum side of a frame in pixels: two patches of as many pixels as an autocorrelation has lags."""

MIN_SIGMA = 5.0
"""Minimum correlation of consecutive groups in standard deviations; among fifty pairs and fifty angles, chance exceeds it with a
probability of 0.001."""

MIN_LIGHT = 1e-4
"""Least square of the light of a frame, over the usual one, by which r*r is divided."""

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
        common: share of the power of the speckle that consecutive frames have in common, because the laser is at rest.
        numbers: number of each frame from the first, (frames,), of which files may be missing; None if frames are counted.
        order: doubts about the order of the frames.
    """

    angle_deg: np.ndarray
    distance_ratio: np.ndarray
    angle_error_deg: float
    distance_error: float
    frames_per_angle: int
    interval_s: float | None = None
    common: float = 0.0
    numbers: np.ndarray | None = None
    order: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Doubts about angles and distances, in words."""
        doubts = [*([] if self.numbers is None else missing_frames(self.numbers)), *self.order]
        if self.common >= MIN_SHARE:
            doubts.append(
                f"consecutive frames share {100.0 * self.common:.0f} % of their speckle, as if the laser were at rest: its light does not "
                "turn with the object, and angles and distances are wrong by more than stated; move the laser between frames"
            )
        return tuple(doubts)

    @classmethod
    def of(cls, turns: Turns, frames_per_angle: int, interval_s: float | None) -> Rotation:
        """Return the rotation from the turns of both halves of each group: means, and errors from the differences between the halves.

        The illumination's speckle changes r*r at many lags at once, so that residuals within one group do not show its errors. What a
        difference is expected to be follows from that of the halves around it, a third of it for any rate that changes uniformly.
        """
        halves = np.stack([np.degrees(turns.angle), -np.log(turns.scale)])
        halves = halves[:, : halves.shape[1] // 2 * 2]
        means = halves.reshape(2, -1, 2).mean(2)
        angle, distance = means - means[:, :1]
        left = halves[:, 2:-1] - halves[:, 1:-2] - (halves[:, 3:] - halves[:, :-3]) / 3.0
        errors = np.sqrt((left**2).mean(1) * 9.0 / 20.0)
        return cls(angle, np.exp(distance), float(errors[0]), float(errors[1]), frames_per_angle, interval_s)

    @property
    def middle_frame(self) -> np.ndarray:
        """Index of the frame in the middle of each group, (groups,)."""
        return self.frames_per_angle * (np.arange(len(self.angle_deg)) + 0.5) - 0.5

    @property
    def middle_number(self) -> np.ndarray:
        """Number of the frame in the middle of each group, (groups,), with frames that are missing."""
        if self.numbers is None:
            return self.middle_frame
        return np.interp(self.middle_frame, np.arange(len(self.numbers)), self.numbers)

    def angle_at(self, frames: np.ndarray) -> np.ndarray:
        """Return the angle in degrees at indices of frames; straight lines connect the groups and continue beyond them."""
        return np.asarray(interp1d(self.middle_frame, self.angle_deg, fill_value="extrapolate")(frames))

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
        place = self.middle_number * (self.interval_s if known else 1.0)
        upper.errorbar(place, self.angle_deg, self.angle_error_deg, fmt=".-", capsize=2)
        upper.set_ylabel("angle (degrees)")
        lower.errorbar(place, self.distance_ratio, self.distance_error, fmt=".-", capsize=2)
        lower.set(xlabel="time (s)" if known else "frame", ylabel="distance / first distance")
        return figure

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON, without the list of angles."""
        rate = (
            None if self.interval_s is None else float(np.polyfit(self.middle_number * self.interval_s, self.angle_deg, 1)[0])
        )
        return {
            "groups": len(self.angle_deg),
            "frames_per_angle": self.frames_per_angle,
            "interval_s": self.interval_s,
            "turn_deg": float(self.angle_deg[-1]),
            "angle_error_deg": self.angle_error_deg,
            "mean_rate_deg_per_s": rate,
            "distance_ratio": float(self.distance_ratio[-1]),
            "distance_error": self.distance_error,
            "warnings": list(self.warnings),
        }

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns of the table: middle frame, seconds if known, angle and distance."""
        table = {"frame": self.middle_number}
        if self.interval_s is not None:
            table["time_s"] = self.middle_number * self.interval_s
        return table | {"angle_deg": self.angle_deg, "distance_ratio": self.distance_ratio}

    def save(self, folder: str | Path) -> Path:
        """Write rotation.csv, rotation.json and rotation.png; return the folder."""
        return save_table(folder, ROTATION_FILES, (self.columns(), self.as_dict(), self.plot()))


def track_rotation(capture: Capture, *, interval_s: float | None = None) -> Rotation:
    """Find the rotation of the object about the line of sight and the change of its distance.

    The autocorrelations of consecutive frames are averaged in groups of two halves, as short as the light permits. The object must turn by
    less than a quarter from one half to the next. The laser may move. If it is at rest, its illumination does not turn with the object and
    draws the angle towards zero, unless its grain is much smaller than a lag.

    Raises InputError for too few frames, frames that are too small or equal, too little light, and objects that look alike at every
    angle or after a quarter turn.
    """
    check_frames(capture, interval_s, 2 * MIN_ANGLES, "rotation")
    numbers = frame_numbers(capture)
    found = rotation_of(*_signals(capture), interval_s)
    return replace(found, common=common_share(capture.frames), numbers=numbers, order=tuple(doubts_of_order(capture.names)))


def rotation_of(signals: Sequence[np.ndarray], aspect: float, weights: np.ndarray, interval_s: float | None = None) -> Rotation:
    """Return the rotation from r*r of each frame without floor (n, n); see `track_rotation`.

    Args:
        aspect: pitch of the lags along rows over that along columns.
        weights: weight of each frame in the mean of its group, (frames,).

    Raises InputError for too little light, and objects that look alike at every angle.
    """
    size = -(-len(signals) // MAX_HALVES)
    while len(signals) // (2 * size) >= MIN_ANGLES:
        turns = find_turns(group_means(signals, size, weights), aspect)
        found = Rotation.of(turns, 2 * size, interval_s)
        if turns.significance >= MIN_SIGMA and found.angle_error_deg <= MAX_ERROR_DEG:
            return found
        size *= 2
    expected = f"autocorrelations whose angle is known to {MAX_ERROR_DEG:g} degrees"
    raise InputError(
        "frames",
        expected,
        "none",
        "add light, or more frames per second if the rate of rotation changes; a jump shows no angle, nor does a round object or one that "
        "looks alike after a quarter turn",
    )


def signal_of(values: np.ndarray, transfer: np.ndarray | None) -> np.ndarray:
    """Return an estimate (n, n) without its floor, divided by the transfer of the camera where it shows a signal."""
    measurement = read_measurement(values, transfer=transfer)
    return measurement.values - measurement.noise.floor


def relative_light(levels: Sequence[float]) -> np.ndarray:
    """Return the square of the light of each frame over the mean square, (frames,), to which r*r is proportional, from their means."""
    light = np.maximum(levels, 0.0) ** 2
    return np.maximum(light / max(float(light.mean()), 1e-300), MIN_LIGHT)


def _signals(capture: Capture) -> tuple[list[np.ndarray], float, np.ndarray]:
    """Return r*r of each frame without floor, for equal light, (127, 127); the pitch of its lags along rows over that along columns; and
    the relative light of each frame, (frames,), which is its weight."""
    shape = capture.frames[0].shape
    if min(shape) < MIN_SIDE:
        raise InputError("frames", f"sides of {MIN_SIDE} pixels or more for a rotation", shape, "use larger frames")
    check_frames_in_memory(capture.frames)
    request, values, levels = Request(lags=LAGS), [], []
    whole = estimate_from_frames(capture, request)  # refuses copies of one frame
    for frame in tqdm(capture.frames, desc="autocorrelations", unit="frame", disable=None, leave=False):
        estimate = estimate_from_frames(replace(capture, frames=[frame], names=()), request)
        values.append(estimate.values)
        levels.append(float(np.mean(frame)))
    assert whole.record is not None
    at_rest = np.mean(values, 0) - whole.values if whole.record.background.fixed_pattern_lags else 0.0
    pitches, light = whole.pitches_m, relative_light(levels)
    signals = [signal_of(one / part - at_rest, whole.transfer) for one, part in zip(values, light, strict=True)]
    return signals, 1.0 if pitches is None else pitches[0] / pitches[1], light
