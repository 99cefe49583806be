"""`python -m benchmarks.streaming [--frames 100]`: memory and time of an estimate from a stack of frames.

A stack of 16-bit frames of 5 megapixels is written to a temporary folder. The time of the estimate is compared with that of
reading the frames and one FFT of each on the same padded grid in the same run. The peak of the memory of the process is printed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from correlograph.files.capture import CameraMetadata
from correlograph.files.stacks import open_stack
from invert.measure import capture as capture_module
from invert.measure.capture import read_capture
from invert.measure.estimate import estimate_from_frames
from radiometry.autocorrelation import patch_grid
from radiometry.estimation.whole_frames import AutocorrelationEstimator

SHAPE, PATCH = (2056, 2464), 257


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100)
    options = parser.parse_args()
    capture_module.MAX_KEPT_BYTES = 0
    with tempfile.TemporaryDirectory() as folder:
        file, rng = Path(folder) / "stack.npy", np.random.default_rng(1)
        with open(file, "wb") as stream:
            header = {"descr": "<u2", "fortran_order": False, "shape": (options.frames, *SHAPE)}
            np.lib.format.write_array_header_1_0(stream, header)
            for _ in range(options.frames):
                stream.write(rng.poisson(2.0, SHAPE).astype("<u2").tobytes())

        estimator, frames = AutocorrelationEstimator(patch_grid(SHAPE, PATCH)), open_stack(file)
        begin, cpu = time.perf_counter(), time.process_time()
        for number in range(options.frames):
            torch.fft.rfft2(torch.from_numpy(frames.read(number)[0]), s=estimator.padded)
        reference, reference_cpu = time.perf_counter() - begin, time.process_time() - cpu

        begin, cpu = time.perf_counter(), time.process_time()
        estimate_from_frames(read_capture([file], CameraMetadata()), PATCH, "cpu")
        found, found_cpu = time.perf_counter() - begin, time.process_time() - cpu
    print(f"{options.frames} frames of {SHAPE[0]} x {SHAPE[1]} pixels")
    print(f"reading and FFT: {reference:.1f} s, {reference_cpu:.1f} CPU s")
    print(f"estimate: {found:.1f} s, {found_cpu:.1f} CPU s; speed {reference / found:.2f} of reading and FFT")
    print(f"peak memory: {_peak_bytes() / 1e9:.2f} GB")


def _peak_bytes() -> float:
    import resource

    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main()
