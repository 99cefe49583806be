"""`python -m benchmarks.scenes --draw FILE`: render and reconstruct every shipped scene, and compare with its truth."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from correlograph.files.exr_frames import read_frame
from invert.__main__ import main as invert
from invert.albedo.metrics import aligned_pearson
from radiometry.noise.measured_noise import dim_zero_lag
from scenes import scene_path
from sim.__main__ import main as sim

SCENES = ("corner_letter", "tilted_letter", "occluded_letter", "two_depths", "glyph_mesh", "strong_ambient", "long_standoff")
CORNER = 257
"""Pixels of the first frame that are shown."""


def reconstruct(name: str, folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """A corner of the first frame, the estimate, the reconstruction laid over the truth, the truth, their correlation."""
    sim([str(scene_path(name)), "-o", str(folder / "capture"), "--frames", "2", "--seed", "1"])
    invert([str(folder / "capture"), "-o", str(folder / "result")])
    truth, albedo, estimate = (
        np.load(folder / file, allow_pickle=False)
        for file in ("capture/truth.npy", "result/albedo.npy", "result/autocorrelation.npy")
    )
    pearson, moved = aligned_pearson(albedo, truth)
    frame, _ = read_frame(folder / "capture" / "frame_0000.exr")
    return frame[:CORNER, :CORNER], dim_zero_lag(estimate), moved, truth, pearson


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
