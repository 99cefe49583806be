"""One picture a result: frame, autocorrelation, reconstruction, truth where it is known, and the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from radiometry.files.output import atomic
from radiometry.noise.level import centre_dimmed


def save_picture(path: Path, image: np.ndarray, scale: int = 8) -> None:
    """8-bit greyscale PNG, white is the largest value, each pixel enlarged."""
    from PIL import Image

    top = float(image.max())
    grey = np.round(np.clip(image / top if top > 0.0 else image, 0.0, 1.0) * 255.0).astype(np.uint8)
    with atomic(path) as partial:
        Image.fromarray(np.kron(grey, np.ones((scale, scale), np.uint8))).save(partial, format="PNG")


def save_report(path: Path, *, frame: np.ndarray | None, estimate: np.ndarray, albedo: np.ndarray,
                truth: np.ndarray | None, numbers: list[str]) -> None:
    """Draw the panels side by side with a line of numbers below.

    Args:
        frame: one speckle frame (H, W), None when the input was an autocorrelation.
        estimate: (127, 127); shown without its floor's lower tail, zero lag left out of the scale.
        albedo: (64, 64), already registered to `truth` if there is one.
    """
    from matplotlib.figure import Figure

    panels: list[tuple[str, np.ndarray, dict[str, float]]] = []
    if frame is not None:
        corner = frame[:257, :257]
        low, high = float(corner.min()), float(corner.max())
        limits = {"vmin": low, "vmax": high if high > low else low + 1.0}
        panels.append(("speckle (a corner of the first frame)", corner, limits))
    shown = centre_dimmed(estimate)
    panels.append(("autocorrelation estimate", shown, {"vmin": float(np.quantile(shown, 0.01)), "vmax": float(shown.max())}))
    panels.append(("reconstruction", albedo, {"vmin": 0.0, "vmax": float(albedo.max()) or 1.0}))
    if truth is not None:
        panels.append(("truth", truth, {"vmin": 0.0, "vmax": float(truth.max()) or 1.0}))
    figure = Figure(figsize=(3.4 * len(panels), 4.4), layout="constrained")
    for index, (title, image, limits) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), index + 1)
        axes.imshow(image, cmap="gray", interpolation="nearest", **limits)
        axes.set_title(title, fontsize=10)
        axes.set_xticks([])
        axes.set_yticks([])
    figure.supxlabel("\n".join(numbers), fontsize=9, parse_math=False)  # names of files may hold any sign
    with atomic(path) as partial:
        figure.savefig(partial, format="png", dpi=110)


def save_contact_sheet(path: Path, albedos: Sequence[np.ndarray], titles: Sequence[str]) -> None:
    """Draw reconstructions (64, 64) side by side, ten a row, each below its title."""
    from matplotlib.figure import Figure

    columns = min(10, len(albedos))
    rows = -(-len(albedos) // columns)
    figure = Figure(figsize=(1.5 * columns, 1.85 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid:
        axes.set_axis_off()
    for axes, albedo, title in zip(grid, albedos, titles, strict=False):
        axes.imshow(albedo, cmap="gray", interpolation="nearest", vmin=0.0, vmax=float(albedo.max()) or 1.0)
        axes.set_title(title, fontsize=7, parse_math=False)
    with atomic(path) as partial:
        figure.savefig(partial, format="png", dpi=110)
