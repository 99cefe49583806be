"""Time and memory of the steps from scene to fields, on frames of 1028 x 1232 pixels."""

from __future__ import annotations

import numpy as np

import correlograph as cg
from invert.measure.estimate import estimate_from_frames
from invert.request import Request


class Pipeline:
    """Two rendered frames of the reference scene, and their reconstruction of quality `fast`."""

    timeout = 600.0
    number, repeat, warmup_time = 1, 3, 0.0

    def setup_cache(self) -> tuple[list[np.ndarray], cg.CameraMetadata]:
        """Return the frames and the metadata of their camera."""
        capture = cg.render("corner_letter", frames=2, seed=1)
        return [frame[:1028, :1232] for frame in capture.frames], capture.camera

    def setup(self, cached: tuple[list[np.ndarray], cg.CameraMetadata]) -> None:
        frames, camera = cached
        self.capture = cg.Capture(frames, camera)
        self.estimate = estimate_from_frames(self.capture, Request())

    def time_estimate(self, cached: object) -> None:
        estimate_from_frames(self.capture, Request())

    def time_fast(self, cached: object) -> None:
        cg.reconstruct(self.estimate, quality="fast")

    def time_classical(self, cached: object) -> None:
        cg.reconstruct(self.estimate, method="classical", quality="fast")

    def time_field(self, cached: object) -> None:
        cg.reconstruct(self.capture, method="field", quality="fast")

    def peakmem_fast(self, cached: object) -> None:
        cg.reconstruct(self.estimate, quality="fast")
