"""`python -m benchmarks.streaming [--frames 100 | --live]`: memory and time of an estimate from a stack; frames that the live view drops.

A stack of 16-bit frames of 5 megapixels is written to a temporary folder. The time of the estimate is compared with that of
reading the frames and one FFT of each on the same padded grid in the same run. The peak of the memory of the process is printed.

With `--live`, a camera repeats eight rendered frames of the reference scene (5 megapixels), each mirrored in four ways so that they
differ, at `--frames-per-s` for `--seconds`. The numbers of frames that the live view adds and drops are printed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from correlograph.files import captured_frames as capture_module
from correlograph.files.capture import CameraMetadata
from correlograph.files.captured_frames import read_capture
from correlograph.files.stacks import open_stack
from correlograph.live.session import LiveSession
from correlograph.live.threads import Acquisition
from invert.measure.estimate import estimate_from_frames
from invert.request import Request
from radiometry.autocorrelation import patch_grid
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator
from sim.rendering import render_geometry
from sim.scene import load

SHAPE, PATCH = (2056, 2464), 257


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
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--live", action="store_true")
    parser.add_argument("--frames-per-s", type=float, default=20.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    if options.live:
        follow_camera(options.frames_per_s, options.seconds)
    else:
        stream_frames(options.frames)


def stream_frames(frames_in_all: int) -> None:
    """Print memory, time and speed of an estimate from a stack."""
    capture_module.MAX_KEPT_BYTES = 0
    with tempfile.TemporaryDirectory() as folder:
        file, rng = Path(folder) / "stack.npy", np.random.default_rng(1)
        with open(file, "wb") as stream:
            header = {"descr": "<u2", "fortran_order": False, "shape": (frames_in_all, *SHAPE)}
            np.lib.format.write_array_header_1_0(stream, header)
            for _ in range(frames_in_all):
                stream.write(rng.poisson(2.0, SHAPE).astype("<u2").tobytes())

        estimator, frames = AutocorrelationEstimator(patch_grid(SHAPE, PATCH)), open_stack(file)
        begin, cpu = time.perf_counter(), time.process_time()
        for number in range(frames_in_all):
            torch.fft.rfft2(torch.from_numpy(frames.read(number)[0]), s=estimator.padded)
        reference, reference_cpu = time.perf_counter() - begin, time.process_time() - cpu

        begin, cpu = time.perf_counter(), time.process_time()
        estimate_from_frames(read_capture([file], CameraMetadata()), Request(patch=PATCH))
        found, found_cpu = time.perf_counter() - begin, time.process_time() - cpu
    print(f"{frames_in_all} frames of {SHAPE[0]} x {SHAPE[1]} pixels")
    print(f"reading and FFT: {reference:.1f} s, {reference_cpu:.1f} CPU s")
    print(f"estimate: {found:.1f} s, {found_cpu:.1f} CPU s; speed {reference / found:.2f} of reading and FFT")
    print(f"peak memory: {_peak_bytes() / 1e9:.2f} GB")


def follow_camera(frames_per_s: float, seconds_in_all: float) -> None:
    """Print how many camera frames the live view adds to its estimate and how many it drops."""
    capture = render_geometry(load("corner_letter").geometry, 8)
    views = [np.ascontiguousarray(frame[::down, ::right]) for frame in capture.frames for down in (1, -1) for right in (1, -1)]
    camera = RepeatingCamera(views, capture.camera, frames_per_s, seconds_in_all)
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


def _peak_bytes() -> float:
    import resource

    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main()
