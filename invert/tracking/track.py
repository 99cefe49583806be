"""Path of a hidden object from frames with the laser at rest."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from tqdm import tqdm

from correlograph.errors import InputError, check_positive
from correlograph.files.capture import Capture
from correlograph.files.figures import figure_as_html, save_figure
from correlograph.files.output import atomic, output_folder, save_json, sole_writer
from invert.tracking.shifts import Shift, cross_correlation, find_shift, spectrum_of, weights_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRACK_FILES = ("track.csv", "track.png", "track.json")

STEPS = (1, 2, 4)
"""Numbers of frames between those that are compared; shifts over several frames keep errors from adding up."""

FRAMES_FOR_WEIGHTS = 32
"""Number of frames from which the power spectrum is measured."""

MIN_SIGNIFICANCE = 6.0
"""Standard deviations above which the common motion counts as found; the highest of a million shifts of noise lies at 5."""

MIN_PAIR_SIGNIFICANCE = 4.5
"""The same for one pair of frames, whose shift is searched near the common one only."""

REACH_PIXELS = 10
"""Distance from the common motion up to which the shift of a pair is searched."""


@dataclass(frozen=True)
class Track:
    """Motion of the speckle over the wall, and of the object if its geometry is known.

    Attributes:
        path_pixels: position of the speckle in each frame in camera pixels (rows, columns), (frames, 2), from the first frame.
        error_pixels: standard error of each position, (frames, 2).
        step_pixels: mean displacement from frame to frame (2,), with its standard error.
        step_error_pixels: standard error of the mean displacement, (2,).
        significance: significance of the summed cross-correlation of consecutive frames, in standard deviations.
        metres_per_pixel: displacement of the object per pixel along rows and columns; None if its geometry is unknown.
        interval_s: time between frames; None if unknown.
    """

    path_pixels: np.ndarray
    error_pixels: np.ndarray
    step_pixels: np.ndarray
    step_error_pixels: np.ndarray
    significance: float
    metres_per_pixel: tuple[float, float] | None = None
    interval_s: float | None = None

    @property
    def path_m(self) -> np.ndarray | None:
        """Position of the object in each frame in metres, (frames, 2), along the axes of the frame."""
        return None if self.metres_per_pixel is None else self.path_pixels * np.array(self.metres_per_pixel)

    @property
    def velocity_m_s(self) -> np.ndarray | None:
        """Mean velocity of the object (2,)."""
        if self.metres_per_pixel is None or self.interval_s is None:
            return None
        return self.step_pixels * np.array(self.metres_per_pixel) / self.interval_s

    def __repr__(self) -> str:
        rows, columns = self.step_pixels
        speed = self.velocity_m_s
        known = "" if speed is None else f", object {speed[0] * 1e3:.4g} and {speed[1] * 1e3:.4g} mm/s"
        return f"Track({len(self.path_pixels)} frames, {rows:.3f} and {columns:.3f} pixels per frame{known}, {self.significance:.0f} sigma)"

    def _repr_html_(self) -> str:
        return figure_as_html(self.plot(), repr(self))

    def plot(self) -> Figure:
        """Return the path as a matplotlib figure."""
        from matplotlib.figure import Figure

        path, unit = (self.path_pixels, "pixels") if self.path_m is None else (1e3 * self.path_m, "mm")
        figure = Figure(figsize=(5.0, 4.2), layout="constrained")
        axes = figure.add_subplot()
        axes.plot(path[:, 1], path[:, 0], "k.-", linewidth=0.8, markersize=4)
        axes.plot(path[:1, 1], path[:1, 0], "o", mfc="none", label="first frame")
        kind = "speckle on the wall" if self.path_m is None else "object"
        axes.set(xlabel=f"columns ({unit})", ylabel=f"rows ({unit})", title=f"path of the {kind}", aspect="equal")
        axes.invert_yaxis()
        axes.legend(frameon=False)
        return figure

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON, without the path."""
        speed = self.velocity_m_s
        return {
            "frames": len(self.path_pixels),
            "step_pixels": self.step_pixels.tolist(),
            "step_error_pixels": self.step_error_pixels.tolist(),
            "significance": self.significance,
            "metres_per_pixel": self.metres_per_pixel,
            "interval_s": self.interval_s,
            "velocity_m_s": None if speed is None else speed.tolist(),
        }

    def save(self, folder: str | Path) -> Path:
        """Write track.csv, track.json and track.png; return the folder."""
        target = output_folder(str(folder))
        with sole_writer(target):
            columns = [np.arange(len(self.path_pixels)), *self.path_pixels.T, *self.error_pixels.T]
            names = ["frame", "row_pixels", "column_pixels", "row_error_pixels", "column_error_pixels"]
            if self.path_m is not None:
                columns += [*self.path_m.T]
                names += ["row_m", "column_m"]
            with atomic(target / "track.csv") as partial:
                np.savetxt(partial, np.column_stack(columns), "%.9g", ",", header=",".join(names), comments="")
            save_figure(target / "track.png", self.plot())
            save_json(target / "track.json", self.as_dict())
        return target


def track(
    capture: Capture,
    *,
    source_distance_m: float | None = None,
    interval_s: float | None = None,
    binning: int = 1,
) -> Track:
    """Find the motion of the speckle over the frames of a capture with the laser at rest.

    Args:
        source_distance_m: distance from the laser spot to the object; with the metadata of the camera, displacements of the object follow.
        interval_s: time between the starts of two frames.
        binning: pixels that are added along each axis before the comparison; grains should stay wider than two of them.

    Raises InputError for fewer than three frames, and for frames without common motion.
    """
    for name, value in (("source_distance_m", source_distance_m), ("interval_s", interval_s)):
        if value is not None:
            check_positive(name, value)
    if not isinstance(capture, Capture):
        raise InputError("capture", "a Capture", f"{capture!r:.60}", "load it with correlograph.Capture.load")
    if len(capture.frames) < 3:
        raise InputError("frames", "three or more for a path", len(capture.frames), "provide more frames")
    shape = (capture.frames[0].shape[0] // binning, capture.frames[0].shape[1] // binning)
    weights, _, correlation = correlate_consecutive(capture, binning)
    common = find_shift(correlation)
    if common.significance < MIN_SIGNIFICANCE:
        found = (
            f"{common.significance:.1f} standard deviations of the summed cross-correlation, {MIN_SIGNIFICANCE:g} are needed"
        )
        raise InputError(
            "frames", "speckle that moves as a whole", found, "keep the laser at rest, shorten the interval, or add light"
        )
    pairs = list(_pair_shifts(capture, binning, weights, shape, common.pixels))
    path, error = _path(len(capture.frames), pairs, common)
    steps = len(path) - 1
    lever = None if source_distance_m is None else _metres_per_pixel(capture, source_distance_m)
    return Track(
        path * binning,
        error * binning,
        (path[-1] - path[0]) / steps * binning,
        error[-1] / steps * binning,
        common.significance,
        lever,
        interval_s,
    )


def correlate_consecutive(capture: Capture, binning: int) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
    """Return the weights of cross-spectra and the power of the speckle (see `weights_of`), and the sum of the weighted
    cross-correlations of consecutive frames (rows, columns).
    """
    shape = (capture.frames[0].shape[0] // binning, capture.frames[0].shape[1] // binning)
    weights, signal = weights_of(_mean_power(capture, binning), min(len(capture.frames), FRAMES_FOR_WEIGHTS))
    return weights, signal, cross_correlation(_summed_cross_spectrum(capture, binning), weights, shape)


def _mean_power(capture: Capture, binning: int) -> torch.Tensor:
    first = capture.frames[:FRAMES_FOR_WEIGHTS]
    return torch.stack([spectrum_of(frame, binning).abs().square() for frame in first]).mean(0)


def _summed_cross_spectrum(capture: Capture, binning: int) -> torch.Tensor:
    """Return the sum of the cross-spectra of consecutive frames."""
    total, before = torch.zeros(()), None
    for frame in capture.frames:
        spectrum = spectrum_of(frame, binning)
        total = total if before is None else total + before.conj() * spectrum
        before = spectrum
    return total


def _pair_shifts(
    capture: Capture, binning: int, weights: torch.Tensor, shape: tuple[int, int], common: np.ndarray
) -> Sequence[tuple[int, int, Shift]]:
    """Return numbers of two frames and the shift between them, for all pairs that `STEPS` compares and whose peak is significant."""
    kept: deque[torch.Tensor] = deque(maxlen=max(STEPS))
    found, velocity = [], common
    with tqdm(total=len(capture.frames), desc="shifts", unit="frame", disable=None, leave=False) as bar:
        for number, frame in enumerate(capture.frames):
            spectrum = spectrum_of(frame, binning)
            for step in (one for one in STEPS if one <= len(kept)):
                correlation = cross_correlation(kept[-step].conj() * spectrum, weights, shape)
                shift = find_shift(correlation, step * velocity, REACH_PIXELS)
                if shift.significance > MIN_PAIR_SIGNIFICANCE:
                    found.append((number - step, number, shift))
                    velocity = shift.pixels if step == 1 else velocity
            kept.append(spectrum)
            bar.update()
    return found


def _path(frames: int, pairs: Sequence[tuple[int, int, Shift]], common: Shift) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions (frames, 2) that fit all shifts best in the least-squares sense, and their standard errors.

    Consecutive frames without a significant shift of their own are taken to move like the others, give or take the search's reach.
    """
    positions, errors = np.zeros((frames, 2)), np.zeros((frames, 2))
    for axis in (0, 1):
        matrix, right = np.zeros((frames, frames)), np.zeros(frames)
        links = [(a, b, shift.pixels[axis], shift.error[axis] ** -2.0) for a, b, shift in pairs]
        links += [(n, n + 1, common.pixels[axis], float(REACH_PIXELS) ** -2.0) for n in range(frames - 1)]
        for first, second, moved, weight in links:
            for one, sign in ((first, -1.0), (second, 1.0)):
                matrix[one, first] -= sign * weight
                matrix[one, second] += sign * weight
                right[one] += sign * weight * moved
        covariance = np.linalg.inv(matrix[1:, 1:])
        positions[1:, axis] = covariance @ right[1:]
        errors[1:, axis] = np.sqrt(np.diagonal(covariance))
    return positions, errors


def _metres_per_pixel(capture: Capture, source_distance_m: float) -> tuple[float, float]:
    """Return the displacement of the object per pixel: the pitch over 1 + z / d1."""
    known = capture.camera.lag_geometry
    if known is None:
        raise InputError("camera", "wavelength, pixel pitch and distance", "none", "give them with the frames")
    _, distance, pitches = known
    return pitches[0] / (1.0 + distance / source_distance_m), pitches[1] / (1.0 + distance / source_distance_m)
