"""Running estimate of a live capture: measured values, reconstruction, and the frames to save."""

from __future__ import annotations

import math
import os
import shutil
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.captured_frames import check_frame
from correlograph.files.corrections import Corrections
from correlograph.files.exr_frames import FrameHeader, can_write_frames, write_frame
from correlograph.files.manifest import record_temporary
from correlograph.files.output import output_folder, save_array, sole_writer
from correlograph.live.film import Look
from correlograph.live.frame_report import FrameReport, measure_frame
from correlograph.progress import Progress, no_progress
from correlograph.version import version
from invert.measure.estimate import Estimate, estimate_of
from invert.measure.preparation import prepare
from invert.measure.spectrum import estimate_noise, read_measurement
from invert.pipeline import reconstruct
from invert.tracking.travel import find_travel, may_travel, quick_spectra
from radiometry.autocorrelation import PatchGrid, automatic_patch_size, patch_grid
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator
from radiometry.estimation.photon_transfer import PhotonTransfer
from radiometry.estimation.third_moment import MAX_FRAMES
from radiometry.noise.detection import DETECTION_LIMIT

SHARP_ERROR = 0.7
"""Relative error of the estimate at which `fast` reconstructions of letters reach a correlation of 0.9 (docs/radiometry.md)."""

KEPT_BYTES = 2**27
"""Memory for the latest frames, which can be saved."""

FOLLOWED_FRAMES = 64
"""Number of the latest frames that are added along the path of a moving object, at most."""

TREND_FRAMES = 200
"""Number of the latest frames whose contrast is kept."""


@dataclass(frozen=True)
class LiveReport:
    """State of a live capture.

    Attributes:
        frames: number of frames in the estimate.
        detection: significance of the object in standard deviations.
        floor_over_peak, dof: floor over peak and degrees of freedom of the estimate. error: relative L2 error of its signal.
            None if no object is detected.
        detected_in_frames, sharp_in_frames: predicted number of further frames until the object is detected, and until the
            relative error is `SHARP_ERROR`; 0 if reached, None if unpredictable.
    """

    frames: int
    frame: FrameReport
    detection: float
    floor_over_peak: float | None
    dof: float
    error: float | None
    detected_in_frames: int | None
    sharp_in_frames: int | None


class LiveSession:
    """Estimate of the frames of a running camera. All methods may be called from several threads."""

    def __init__(
        self,
        camera: CameraMetadata,
        exposure_s: float | None = None,
        forget: int = 0,
        corrections: Corrections | None = None,
    ) -> None:
        """Start without frames.

        Args:
            corrections: dark frame, flat-field frame and mask for the estimate; frames are saved as they arrive.
            forget: number of frames after which a frame no longer counts, for alignment; 0 for never. The estimate uses
                between half of `forget` and `forget` of the latest frames.
        """
        self.camera, self.exposure_s, self.forget = camera, exposure_s, forget
        self.corrections = corrections or Corrections()
        self.contrasts: deque[float] = deque(maxlen=TREND_FRAMES)
        self._correct: Callable[[np.ndarray], np.ndarray] | None = None
        self._lock = Lock()
        self._shape: tuple[int, ...] = ()
        self._estimators: list[AutocorrelationEstimator] = []
        self._gains: deque[PhotonTransfer] = deque(maxlen=16)
        self._kept: deque[tuple[int, np.ndarray]] = deque()
        self._frame: FrameReport | None = None

    def add(self, frame: np.ndarray, number: int | None = None) -> None:
        """Add a frame (H, W). Raises InputError for one that cannot be speckle, and for another size than that of the frames before.

        Args:
            number: its number among the frames of the camera; by default, the next.
        """
        image = np.asarray(frame, np.float32)
        with self._lock:
            if self._estimators and image.shape != self._shape:
                expected = " x ".join(map(str, self._shape))
                raise InputError("frame", f"{expected} pixels, as before", f"shape {image.shape}", "restart the estimate")
            check_frame(image, Path("a frame of the camera"))
            if not self._estimators:
                if not self.corrections.is_empty:
                    self._correct = self.corrections.for_frames([image])[0]
                self._shape = image.shape
                self._estimators = [self._new_estimator()]
            light = image if self._correct is None else self._correct(image)
            for estimator in self._estimators:
                estimator.add(light)
            self._forget_oldest()
            self._frame = measure_frame(light, image, self._gains)
            self.contrasts.append(self._frame.contrast)
            following = self._kept[-1][0] + 1 if self._kept else 0
            self._kept.append((following if number is None else number, _compact(image)))
            while len(self._kept) > 1 and sum(kept.nbytes for _, kept in self._kept) > KEPT_BYTES:
                self._kept.popleft()

    @property
    def frames(self) -> int:
        """Number of frames in the estimate."""
        return self._estimators[0].frames if self._estimators else 0

    def restart(self) -> None:
        """Forget all frames, for example after a change of the alignment."""
        with self._lock:
            self._estimators = []
            self._gains.clear()
            self._kept.clear()
            self.contrasts.clear()

    def _new_estimator(self) -> AutocorrelationEstimator:
        return AutocorrelationEstimator(self._grid())

    def _grid(self) -> PatchGrid:
        rows, columns = self._shape
        return patch_grid((rows, columns), automatic_patch_size((rows, columns), self.camera.lag_geometry))

    def _forget_oldest(self) -> None:
        """Replace the older of two estimators, which are half of `forget` frames apart, by the younger one."""
        if not self.forget:
            return
        if self._estimators[0].frames >= self.forget and len(self._estimators) > 1:
            del self._estimators[0]
        if len(self._estimators) == 1 and self._estimators[0].frames >= max(1, self.forget // 2):
            self._estimators.append(self._new_estimator())

    def estimate(self) -> Estimate | None:
        """Return the present estimate; None without frames."""
        with self._lock:
            if not self._estimators or not self._estimators[0].frames:
                return None
            estimator = self._estimators[0]
            return estimate_of(
                estimator,
                estimator.estimate(),
                self.camera,
                f"{estimator.frames} live frames",
                self._kept[-1][1].astype(np.float32),
            )

    def report(self, estimate: Estimate, frames: int | None = None) -> LiveReport:
        """Return the state that belongs to an estimate of this session.

        Args:
            frames: number of frames that it is from; by default, what its record says, which counts groups along a path.
        """
        if frames is None:
            frames = estimate.record.frames if estimate.record else 0
        measurement = read_measurement(estimate.values, estimate.quantisation, estimate.transfer)
        error = estimate_noise(measurement) if measurement.detectable else None
        assert self._frame is not None
        return LiveReport(
            frames,
            self._frame,
            measurement.detection,
            measurement.floor_over_peak,
            measurement.noise.dof or 0.0,
            error,
            _further_frames(frames, DETECTION_LIMIT / max(measurement.detection, 1e-3)),
            None if error is None else _further_frames(frames, error / SHARP_ERROR),
        )

    def reconstruct(self, estimate: Estimate, quality: str, progress: Progress = no_progress) -> Look | None:
        """Reconstruct the object from an estimate of this session, as `correlograph.reconstruct` does; if it moves while the laser is at
        rest, from the latest frames, along the path of their speckle. Return None if the session has been restarted."""
        with self._lock:
            latest = list(self._kept)[-FOLLOWED_FRAMES:]
        if not latest or estimate.record is None:
            return None
        numbers, frames = zip(*latest, strict=True)
        grid = estimate.record.grid
        if may_travel(quick_spectra(frames[-MAX_FRAMES:], grid)):
            capture = prepare(Capture(frames, self.camera, tuple(map(str, numbers))), self.corrections)[0]
            progress(0)  # the work may end here
            if find_travel(capture) is not None:
                progress(0)
                # Without a camera, patches are an eighth of the frame, which is smaller where edges are cut off.
                patch = grid.size if self.camera.lag_geometry is None else None
                found = reconstruct(capture, quality=quality, progress=progress, lags=grid.lags, patch=patch)
                if found.track is not None:
                    return Look(found, np.array(capture.names, int))
        return Look(reconstruct(estimate, quality=quality, progress=progress), np.array(numbers[-1:]))

    def save(self, folder: Path) -> Path:
        """Write the kept frames into a new folder that `invert` reads, and return it.

        They are EXR files with metadata if the camera is known and OpenEXR is installed, and otherwise one file frames.npy.
        """
        with self._lock:
            frames = [image for _, image in self._kept]
        if not frames:
            raise InputError("frames", "frames to save", "none so far", "wait for the camera")
        parent = output_folder(folder)
        with sole_writer(parent):
            target = new_folder(parent, "capture")
            staging = parent / f".{target.name}.partial"
            record_temporary(staging)
            staging.mkdir()
            try:
                self._write(frames, staging)
                os.replace(staging, target)
            finally:
                shutil.rmtree(staging, ignore_errors=True)
        return target

    def _write(self, frames: list[np.ndarray], folder: Path) -> None:
        if self.camera.lag_geometry is None or self.exposure_s is None or not can_write_frames():
            save_array(folder / "frames.npy", np.stack(frames).astype(np.float32))
            return
        for number, frame in enumerate(frames):
            write_frame(folder / f"frame_{number:04d}.exr", frame.astype(np.float32), self._header(number))

    def _header(self, number: int) -> FrameHeader:
        camera = self.camera
        assert camera.wavelength_m is not None
        assert camera.pixel_pitch_m is not None
        assert camera.distance_m is not None
        assert self.exposure_s is not None
        return FrameHeader(
            camera.wavelength_m,
            camera.pixel_pitch_m,
            camera.distance_m,
            self.exposure_s,
            0,
            number,
            "",
            version(),
            camera.pupil_diameter_m,
            camera.pupil_distance_m,
            camera.row_pitch_m,
            camera.column_pitch_m,
        )


def new_folder(parent: Path, kind: str) -> Path:
    """Return the path of the next folder of a kind, such as capture_003, which does not exist yet."""
    number = 1
    while (target := parent / f"{kind}_{number:03d}").exists():
        number += 1
    return target


def _compact(image: np.ndarray) -> np.ndarray:
    """Return a frame as integers of 8 or 16 bits if it consists of such numbers, with a quarter or half of the memory."""
    for kind in (np.uint8, np.uint16):
        with np.errstate(invalid="ignore"):
            integers = image.astype(kind)
        if (integers == image).all():
            return integers
    return image


def _further_frames(frames: int, missing: float) -> int | None:
    """Return the frames until a value, which grows with the root of their number, is `missing` times as large.

    None if these are more than a million.
    """
    further = math.ceil(frames * missing**2) - frames
    return max(0, further) if further < 10**6 else None
