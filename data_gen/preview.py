"""`python -m data_gen.preview OUT.zarr`: plot a contact sheet, objects above their autocorrelations (Metzler et al.
2020, Fig. 6)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError
from correlograph.files.figures import save_figure
from correlograph.ranges import Range
from radiometry.noise.measured_noise import dim_zero_lag

COLUMNS = 8


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m data_gen.preview", description="Draw a contact sheet of a dataset.")
    p.add_argument("dataset")
    p.add_argument("-o", "--output", type=Path, help="picture; DATASET.preview.png by default")
    p.add_argument("--rows", type=Range(1, 50), default=3)
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    options = parser().parse_args(argv)
    from correlograph.files.manifest import claim
    from correlograph.files.store import read_rows
    from data_gen.dataset import dataset_schema_of, open_dataset
    from radiometry.noise.model import autocorrelate_windowed

    group = open_dataset(options.dataset)
    output = options.output or Path(options.dataset.rstrip("/")).with_suffix(".preview.png")
    if options.output is None and "://" in options.dataset:
        raise InputError("-o", "a picture's name for a store that is not on this machine", "none", "add -o PICTURE.png")
    claim(output.parent, [output.name], overwrite=options.overwrite)
    count = group["albedo"].shape[0]
    chosen = np.linspace(0, count - 1, min(COLUMNS * options.rows, count)).astype(int)
    schema = dataset_schema_of(options.dataset)

    def read(name: str) -> np.ndarray:
        return read_rows(group, options.dataset, name, chosen, schema)

    albedo = read("albedo")
    if "autocorrelation" in schema.arrays:
        lags = read("autocorrelation").astype(np.float32)
        captions = [f"b {floor:.2g}, K {dof:.3g}" for floor, dof in zip(read("floor_over_peak"), read("dof"), strict=True)]
    else:
        lags, captions = autocorrelate_windowed(torch.from_numpy(albedo).float()).numpy(), ["no noise"] * len(chosen)
    if not (np.isfinite(lags).all() and set(np.unique(read("split"))) <= {0, 1}):
        raise InputError("dataset", "finite lags, and splits of 0 and 1", f"others in {options.dataset}", "make it again")
    save_sheet(output, albedo, lags, captions)
    print(f"{output}: {len(chosen)} of {count} samples")


def save_sheet(path: Path, albedo: np.ndarray, lags: np.ndarray, captions: list[str]) -> None:
    """Plot albedos (n, 64, 64) above their autocorrelations (n, 127, 127), eight per row."""
    from matplotlib.figure import Figure

    rows = -(-len(albedo) // COLUMNS)
    figure = Figure(figsize=(1.6 * COLUMNS, 3.6 * rows), layout="constrained")
    for index, (image, estimate, caption) in enumerate(zip(albedo, lags, captions, strict=True)):
        row, column = divmod(index, COLUMNS)
        for part, (picture, title) in enumerate(((image, ""), (dim_zero_lag(estimate), caption))):
            axes = figure.add_subplot(2 * rows, COLUMNS, (2 * row + part) * COLUMNS + column + 1)
            axes.imshow(picture, cmap="gray", interpolation="nearest", vmin=0.0)
            axes.set_title(title, fontsize=7)
            axes.axis("off")
    save_figure(path, figure, 100)


if __name__ == "__main__":
    run_command(main)
