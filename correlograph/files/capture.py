"""A capture: frames of one scene and what is known about the camera that took them, between `sim` and `invert`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture_folder import frame_path, replace_capture, stage_capture
from correlograph.files.frames import FrameHeader, write_frame
from correlograph.files.output import output_folder, save_array, save_json


@dataclass(frozen=True)
class CameraMetadata:
    """What is known of the capture; None where it is not. Lengths in metres, pitch on a wall that faces the camera.

    `row_pitch_m` and `column_pitch_m` differ from it where camera or wall stand at an angle.
    """

    wavelength_m: float | None = None
    pixel_pitch_m: float | None = None
    distance_m: float | None = None
    pupil_diameter_m: float | None = None
    pupil_distance_m: float | None = None
    row_pitch_m: float | None = None
    column_pitch_m: float | None = None

    @property
    def lag_geometry(self) -> tuple[float, float, tuple[float, float]] | None:
        """(wavelength, distance, pitches of rows and of columns as the object sees them), None unless all are known."""
        if self.wavelength_m is None or self.distance_m is None or self.pixel_pitch_m is None:
            return None
        pitches = self.row_pitch_m or self.pixel_pitch_m, self.column_pitch_m or self.pixel_pitch_m
        return self.wavelength_m, self.distance_m, pitches

    @classmethod
    def of(cls, header: FrameHeader | None) -> CameraMetadata:
        """What a frame's header says, in the single precision of its file: memory and file are inverted alike."""
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


@dataclass(frozen=True)
class Capture:
    """Frames of one capture.

    Attributes:
        frames: each float32 (H, W).
        camera: what is known of the camera.
        names: of the frames, for reports.
        truth: the hidden object's albedo on the lag grid, (64, 64), where the frames were rendered.
        record: what `sim.json` holds of rendered frames, the plan among it.
        headers: of rendered frames.
    """

    frames: Sequence[np.ndarray]
    camera: CameraMetadata = CameraMetadata()
    names: tuple[str, ...] = ()
    truth: np.ndarray | None = None
    record: dict[str, Any] = field(default_factory=dict)
    headers: tuple[FrameHeader, ...] = ()

    @property
    def plan(self) -> dict[str, Any] | None:
        """The plan that rendered frames followed, None for captured ones."""
        return self.record.get("plan")

    def save(self, folder: str | Path) -> Path:
        """Write rendered frames with truth.npy and sim.json, as `python -m sim` does. InputError for captured frames."""
        if len(self.headers) != len(self.frames) or self.truth is None:
            raise InputError("capture", "frames that were rendered", "captured ones", "their files are elsewhere already")
        target = output_folder(folder)
        with stage_capture(target) as staging:
            for number, (frame, header) in enumerate(zip(self.frames, self.headers, strict=True)):
                write_frame(frame_path(staging, number), frame, header)
            save_array(staging / "truth.npy", self.truth)
            save_json(staging / "sim.json", self.record)
            replace_capture(staging, target)
        return target
