"""`python -m benchmarks.scenes --draw FILE`: every scene rendered and inverted by the two commands, beside its truth."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from invert.__main__ import main as invert
from invert.metrics import aligned_pearson
from radiometry.autocorrelation import LAGS
from radiometry.frames import read_frame
from scenes import scene_path
from sim.__main__ import main as sim

SCENES = ("corner_letter", "tilted_letter", "occluded_letter", "two_depths", "glyph_mesh", "strong_ambient", "long_standoff")


def reconstruct(name: str, folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """A corner of the first frame, the estimate, the reconstruction laid over the truth, the truth, their correlation."""
    sim([str(scene_path(name)), "-o", str(folder / "capture"), "--frames", "2", "--seed", "1"])
    truth = folder / "capture" / "truth.npy"
    invert([str(folder / "capture"), "-o", str(folder / "result"), "--truth", str(truth)])
    load = {file: np.load(folder / "result" / f"{file}.npy", allow_pickle=False) for file in ("albedo", "autocorrelation")}
    shown = np.load(truth, allow_pickle=False)
    _, moved = aligned_pearson(load["albedo"], shown)
    estimate = load["autocorrelation"]
    estimate[LAGS, LAGS] = np.partition(estimate.ravel(), -2)[-2]
    frame, _ = read_frame(folder / "capture" / "frame_0000.exr")
    pearson = json.loads((folder / "result" / "result.json").read_text())["pearson"]
    return frame[:257, :257], estimate, moved, shown, pearson


def main() -> None:
    """Print the correlations, draw the pictures, one row a scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draw", type=Path, required=True, help="PNG to write")
    path = parser.parse_args().draw
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 2 * len(SCENES)), layout="constrained")
    grid = figure.subplots(len(SCENES), 4)
    for row, name in zip(grid, SCENES, strict=True):
        with tempfile.TemporaryDirectory() as folder:
            *pictures, pearson = reconstruct(name, Path(folder))
        print(f"{name}: correlation with the truth {pearson:.2f}", flush=True)
        for axes, picture in zip(row, pictures, strict=True):
            axes.imshow(picture, cmap="gray", interpolation="nearest")
            axes.set_xticks([])
            axes.set_yticks([])
        row[0].set_ylabel(name, fontsize=9)
        row[2].set_xlabel(f"{pearson:.2f}", fontsize=9)
    for axes, title in zip(grid[0], ("speckle, a corner", "autocorrelation estimate", "reconstruction", "truth"), strict=True):
        axes.set_title(title, fontsize=9)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
