"""`python -m benchmarks.cost -o FOLDER`: CPU time and accuracy of every method at 64, 128 and 256 pixels, from two rendered frames.

The time is the CPU time of one thread, in units of the CPU time of ten thousand pairs of real 128 x 128 FFTs in the same run. It
includes the autocorrelation. The object is the letter F (64 pixels, 1/8 s) or a page of text (1 s). The U-net of Metzler et al. 2020
is untrained, so it has no accuracy here; its time, without the autocorrelation, does not depend on its weights.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import torch
from matplotlib.figure import Figure
from PIL import Image

import correlograph as cg
from benchmarks.pages import PAGES, page
from correlograph.files.figures import save_figure
from invert.network.inference import make_observation, predict
from invert.network.paper_unet import PaperUnet
from sim.rendering import lag_grid_albedo

PAIRS, BATCH = 10_000, 16

SIZES = ((63, 300e-6, None), (127, 150e-6, PAGES[0][1]), (255, 75e-6, PAGES[3][1]))
"""Largest lag, lag pitch in metres, and text; None for the letter of the scene."""

T = TypeVar("T")

ALL_METHODS = ("unet:fast", "unet:balanced", "unet:best", "classical:balanced", "hio:balanced")


def time_of(run: Callable[..., T], *args: Any, **options: Any) -> tuple[T, float]:
    """Return what a call returns, and its CPU seconds."""
    begin = time.process_time()
    return run(*args, **options), time.process_time() - begin


def fft_pairs() -> None:
    batch = torch.rand(BATCH, 128, 128)
    for _ in range(PAIRS // BATCH):
        torch.fft.irfft2(torch.fft.rfft2(batch), s=(128, 128))


def render(text: str | None, folder: Path) -> tuple[cg.Scene, cg.Capture]:
    """Return the scene of a text, or of the letter F, and two frames."""
    if text is None:
        scene = cg.load("corner_letter")
    else:
        Image.fromarray(page(text)).save(folder / "page.png")
        scene = cg.load("corner_letter", albedo=str((folder / "page.png").resolve()), exposure=1.0)
    return scene, cg.render(scene, frames=2, seed=5)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--methods", nargs="+", default=ALL_METHODS, metavar="METHOD:QUALITY")
    options = parser.parse_args(argv)
    options.output.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    cg.reconstruct(cg.render(cg.load("corner_letter"), frames=2), quality="balanced")  # loads all modules
    unit = min(time_of(fft_pairs)[1] for _ in range(5))
    print(f"one unit: {unit:.3f} CPU s\n\n| pixels | method | correlation | units |\n|---|---|---|---|")
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for (lags, pitch_m, text), marker in zip(SIZES, "os^", strict=True):
        scene, capture = render(text, options.output)
        for number, choice in enumerate(options.methods):
            method, quality = choice.split(":")
            result, seconds = time_of(cg.reconstruct, capture, method=method, quality=quality, lags=lags, pitch_m=pitch_m)
            grid = result.estimate.record.grid
            correlation = cg.aligned_pearson(result.albedo, lag_grid_albedo(scene.geometry, grid.size, grid.lags)[0])[0]
            print(f"| {lags + 1} | {choice} | {correlation:.2f} | {seconds / unit:.1f} |", flush=True)
            axes.semilogx(seconds / unit, correlation, marker, color=f"C{number}", label=f"{choice}, {lags + 1}")
        if text is None:
            seen = make_observation([result.measurement])
            with torch.no_grad():
                seconds = time_of(predict, PaperUnet().eval(), seen)[1]
            print(f"| {lags + 1} | U-net of Metzler et al. 2020 | | {seconds / unit:.2f} |", flush=True)
    axes.legend(fontsize=6, ncols=len(SIZES))
    axes.set_xlabel("CPU time of one thread, in ten thousand pairs of real 128 x 128 FFTs")
    axes.set_ylabel("correlation with the truth")
    save_figure(options.output / "cost.png", figure)


if __name__ == "__main__":
    main()
