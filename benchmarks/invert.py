"""`python -m benchmarks.invert [--paper WEIGHTS]`: from two whole frames to an albedo, step by step, in a warm process.

For comparison, in the same run: the paper's U-net (untrained if no weights are given, because they do not affect its time)
and one start of 2000 iterations of HIO. The last row repeats `balanced` while four other processes keep the processor busy.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from correlograph.files.capture import Capture
from invert.choices import DEFAULT_WEIGHTS
from invert.measure.estimate import estimate_from_frames
from invert.measure.spectrum import fourier_modulus, read_measurement
from invert.network.checkpoints import load_network
from invert.network.inference import denoise, fuse, make_observation, predict
from invert.network.paper_unet import PaperUnet
from invert.pipeline import reconstruct
from invert.solvers.base import PhaseProblem, solve
from invert.solvers.hio import Hio
from scenes import scene_path
from sim.frame import Simulation
from sim.recording import Recording
from sim.scene_file import load_scene
from sim.scene_reader import read_geometry

REPEATS = 9

BUSY_PROCESSES = 4


def median_seconds(run: Callable[[], object]) -> float:
    run()
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def busy_seconds(run: Callable[[], object]) -> float:
    """Return the median duration of a call while other processes compute without pause."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY_PROCESSES)]
    try:
        return median_seconds(run)
    finally:
        for other in others:
            other.kill()
            other.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--paper", type=Path, help="weights of the paper's network")
    paper_weights = parser.parse_args().paper
    simulation = Simulation(read_geometry(load_scene(scene_path("corner_letter"))[0]))
    frames = [simulation.frame(1, number).numpy() for number in range(2)]
    capture = Capture(frames, Recording(simulation.plan).camera)
    estimate = estimate_from_frames(capture)
    measurement = read_measurement(estimate.values, transfer=estimate.transfer)
    network, _ = load_network(DEFAULT_WEIGHTS)
    paper = load_network(paper_weights)[0] if paper_weights else PaperUnet().to(memory_format=torch.channels_last).eval()
    seen = make_observation([measurement])

    def paper_look() -> None:
        with torch.no_grad():
            predict(paper, seen)

    modulus = fourier_modulus(measurement)
    rows = [
        ("autocorrelation of two frames", lambda: estimate_from_frames(capture)),
        ("noise level", lambda: read_measurement(estimate.values, transfer=estimate.transfer)),
        ("denoiser, sketch and fusion, batch 1", lambda: (denoise(network, seen, 1), fuse(network, seen, seen.classical, 1))),
        ("two frames to albedo, fast", lambda: reconstruct(capture, quality="fast")),
        ("estimate to albedo, balanced", lambda: reconstruct(estimate)),
        ("estimate to albedo, best", lambda: reconstruct(estimate, quality="best")),
        ("estimate to albedo, classical", lambda: reconstruct(estimate, method="classical")),
        ("U-net of Metzler et al. 2020, batch 1", paper_look),
        (
            "HIO, 2000 iterations, one start",
            lambda: solve(Hio(starts=1, shrink_every=0), PhaseProblem(modulus, 64), torch.Generator().manual_seed(0)),
        ),
    ]
    print("| | ms |\n|---|---|")
    for name, run in rows:
        print(f"| {name} | {1e3 * median_seconds(run):.1f} |", flush=True)
    busy = busy_seconds(lambda: reconstruct(estimate))
    print(f"| estimate to albedo, balanced, with {BUSY_PROCESSES} other busy processes | {1e3 * busy:.1f} |")


if __name__ == "__main__":
    main()
