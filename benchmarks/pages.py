"""`python -m benchmarks.pages -o FOLDER`: pages of Latin text, rendered, reconstructed with default options, and read by OCR.

Each page covers 1 cm in the scene `corner_letter`. The table and the figure are written to the folder.
"""

from __future__ import annotations

import argparse
import shutil
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

import correlograph as cg
from correlograph.files.figures import save_figure
from data_gen.fonts import dejavu_sans
from invert.evaluation.text import character_error_rate, read_text
from sim.rendering import lag_grid_albedo

PAGES = (
    ("three lines, 10 frames of 1 s", "Hidden\ntext 42\nround", 10),
    ("three lines, 2 frames of 1 s", "Hidden\ntext 42\nround", 2),
    ("four lines, 10 frames of 1 s", "the wall is\na mirror if\nyour laser\nknows where", 10),
    (
        "eight lines, 50 frames of 1 s",
        "The wall has\nno mirror but\nall its light\nstill carries\nwhat the eye\ncannot see of\nhidden pages\nin our corner",
        50,
    ),
)
SIDE, MARGIN = 1024, 0.04


def page(text: str) -> np.ndarray:
    """Return white text on black that fills a square, uint8 (SIDE, SIDE)."""
    lines, space = text.split("\n"), SIDE * (1.0 - 2.0 * MARGIN)
    size = int(0.8 * space / len(lines))
    while max(dejavu_sans(size).getlength(line) for line in lines) > space:
        size -= 2
    canvas = Image.new("L", (SIDE, SIDE))
    for number, line in enumerate(lines):
        place = (SIDE * MARGIN, SIDE * MARGIN + space * (number + 0.5) / len(lines))
        ImageDraw.Draw(canvas).text(place, line, fill=255, font=dejavu_sans(size), anchor="lm")
    return np.asarray(canvas)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("-o", "--output", type=Path, required=True)
    options.add_argument("--quality", nargs="+", default=["fast", "balanced"])
    given = options.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(3.2 * (1 + len(given.quality)), 3.3 * len(PAGES)), layout="constrained")
    grid = figure.subplots(len(PAGES), 1 + len(given.quality))
    print("| page | lags | quality | correlation | confidence | character errors | CPU s |\n|---|---|---|---|---|---|---|")
    for row, (name, text, frames) in zip(grid, PAGES, strict=True):
        Image.fromarray(page(text)).save(given.output / "page.png")
        scene = cg.load("corner_letter", albedo=str((given.output / "page.png").resolve()), exposure=1.0)
        capture = cg.render(scene, frames=frames, seed=5)
        for axes, quality in zip(row[1:], given.quality, strict=True):
            begin = time.process_time()
            result = cg.reconstruct(capture, quality=quality)
            seconds = time.process_time() - begin
            lags = result.estimate.record.grid
            truth = lag_grid_albedo(scene.geometry, lags.size, lags.lags)[0]
            pearson, shown = cg.aligned_pearson(result.albedo, truth)
            errors = (
                f"{100.0 * character_error_rate(text, read_text(shown)):.0f} %" if shutil.which("tesseract") else "not counted"
            )
            pitch_um = 1e6 * result.estimate.pitches_m[0]
            print(
                f"| {name} | {lags.lags} of {pitch_um:.0f} um | {quality} | {pearson:.2f} | {result.confidence:.2f} | "
                f"{errors} | {seconds:.0f} |",
                flush=True,
            )
            axes.imshow(shown, cmap="gray")
            axes.set_title(f"{quality}: correlation {pearson:.2f}, errors {errors}", fontsize=9)
        row[0].imshow(truth, cmap="gray")
        row[0].set_title(name, fontsize=9)
        for axes in row:
            axes.set_axis_off()
    save_figure(given.output / "pages.png", figure)


if __name__ == "__main__":
    main()
