"""`python -m benchmarks.hio [--draw FILE]`: 16 starts of 2000-iteration HIO at 128 x 128 against 64 000 batched real FFT pairs.

`--draw` adds the time of one iteration of one start against the number of starts and the grid.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import torch

from invert.solvers.base import PhaseProblem, solve
from invert.solvers.hio import Hio

STARTS, ITERATIONS, PAIRS, REPEATS = 16, 2000, 64_000, 3


def fft_pairs() -> float:
    """Seconds for 64 000 forward and inverse real 128 x 128 FFTs, 16 at a time."""
    batch = torch.rand(STARTS, 128, 128)
    begin = time.perf_counter()
    for _ in range(PAIRS // STARTS):
        torch.fft.irfft2(torch.fft.rfft2(batch), s=(128, 128))
    return time.perf_counter() - begin


def retrieval() -> float:
    """Seconds for one call of HIO with shrink-wrap."""
    image = torch.zeros(128, 128)
    image[14:47, 20:25], image[14:19, 20:42] = 1.0, 0.6
    modulus = torch.fft.rfft2(image).abs()
    begin = time.perf_counter()
    solve(Hio(iterations=ITERATIONS, starts=STARTS), PhaseProblem(modulus, 40), torch.Generator().manual_seed(0))
    return time.perf_counter() - begin


def draw(path: Path) -> None:
    """Plot the time that one iteration takes for one start, against the number of starts (at 128 x 128) and against the grid size
    (with 16 starts).
    """
    from matplotlib.figure import Figure

    def microseconds(side: int, starts: int) -> float:
        image = torch.zeros(side, side)
        image[side // 8 : side // 3, side // 6 : side // 5] = 1.0
        solver = Hio(iterations=100, starts=starts, shrink_every=0)
        times = []
        for _ in range(3):
            begin = time.perf_counter()
            solve(solver, PhaseProblem(torch.fft.rfft2(image).abs(), side // 2), torch.Generator().manual_seed(0))
            times.append(time.perf_counter() - begin)
        return min(times) / solver.iterations / starts * 1e6

    figure = Figure(figsize=(8, 3.4), layout="constrained")
    over_starts, over_grids = figure.subplots(1, 2)
    starts, sides = [1, 2, 4, 8, 16, 32, 64], [32, 64, 128, 256, 512]
    over_starts.loglog(starts, [microseconds(128, count) for count in starts], "o-")
    over_starts.set_xlabel("starts in one batch, 128 x 128")
    over_grids.loglog(sides, [microseconds(side, 16) for side in sides], "o-")
    over_grids.set_xlabel("side of the grid, 16 starts")
    for axes in (over_starts, over_grids):
        axes.set_ylabel("us an iteration and start")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draw", type=Path)
    wanted = parser.parse_args().draw
    fft_pairs(), retrieval()  # warm up
    for _ in range(REPEATS):
        reference, measured = fft_pairs(), retrieval()
        print(f"HIO {measured:.2f} s, FFT pairs {reference:.2f} s, ratio {measured / reference:.2f}")
    if wanted:
        draw(wanted)


if __name__ == "__main__":
    main()
