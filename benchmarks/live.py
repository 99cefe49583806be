"""`python -m benchmarks.live [--frames-per-s 20 --seconds 20]`: frames that the live view adds and drops at a camera's full rate.

The camera repeats eight rendered frames of the reference scene (5 megapixels), each mirrored in four ways so that they differ.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

import numpy as np

from correlograph.files.capture import CameraMetadata
from correlograph.live.acquisition import Acquisition
from correlograph.live.session import LiveSession
from sim.rendering import render_geometry
from sim.scene import load


class RepeatingCamera:
    """Frames at a constant rate for some seconds."""

    def __init__(self, frames: list[np.ndarray], camera: CameraMetadata, frames_per_s: float, seconds: float) -> None:
        self.camera, self._frames, self._interval_s, self._count = (
            camera,
            frames,
            1.0 / frames_per_s,
            round(frames_per_s * seconds),
        )

    def __iter__(self) -> Iterator[np.ndarray]:
        begin = time.monotonic()
        for number in range(self._count):
            time.sleep(max(0.0, begin + number * self._interval_s - time.monotonic()))
            yield self._frames[number % len(self._frames)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames-per-s", type=float, default=20.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    capture = render_geometry(load("corner_letter").geometry, 8)
    views = [np.ascontiguousarray(frame[::down, ::right]) for frame in capture.frames for down in (1, -1) for right in (1, -1)]
    camera = RepeatingCamera(views, capture.camera, options.frames_per_s, options.seconds)
    acquisition = Acquisition(camera, LiveSession(capture.camera))
    begin = time.monotonic()
    acquisition.start()
    acquisition.finished.wait()
    seconds = time.monotonic() - begin
    acquisition.join()
    added = acquisition.received - acquisition.dropped
    print(
        f"{acquisition.received} frames of {views[0].size / 1e6:.1f} megapixels received in {seconds:.1f} s, "
        f"{acquisition.dropped} dropped, {added / seconds:.2g} added per second; result: {acquisition.result!r}"
    )


if __name__ == "__main__":
    main()
