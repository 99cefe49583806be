"""One picture a result: frame, autocorrelation, reconstruction, truth where it is known, and the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from correlograph.files.output import atomic
from invert.albedo.posterior import Posterior
from radiometry.noise.level import centre_dimmed

Panel = tuple[str, np.ndarray, dict[str, float]]
"""Title, picture and limits of its scale."""

ALTERNATIVES_SHOWN = 2


def save_picture(path: Path, image: np.ndarray, scale: int = 8) -> None:
    """8-bit greyscale PNG, white is the largest value, each pixel enlarged."""
    from PIL import Image

    top = float(image.max())
    grey = np.round(np.clip(image / top if top > 0.0 else image, 0.0, 1.0) * 255.0).astype(np.uint8)
    with atomic(path) as partial:
        Image.fromarray(np.kron(grey, np.ones((scale, scale), np.uint8))).save(partial, format="PNG")


def save_report(path: Path, *, frame: np.ndarray | None, estimate: np.ndarray, albedo: np.ndarray,
                truth: np.ndarray | None, posterior: Posterior | None, numbers: list[str]) -> None:
    """Draw the panels side by side, what the posterior's samples say in a second row, and lines of numbers below.

    Args:
        frame: one speckle frame (H, W), None when the input was an autocorrelation.
        estimate: (127, 127); shown without its floor's lower tail, zero lag left out of the scale.
        albedo: (64, 64), already registered to `truth` if there is one.
    """
    from matplotlib.figure import Figure

    rows = [_result_panels(frame, estimate, albedo, truth)]
    if posterior is not None:
        rows.append(_posterior_panels(posterior))
    columns = max(map(len, rows))
    figure = Figure(figsize=(3.4 * columns, 3.5 * len(rows) + 0.9), layout="constrained")
    grid = figure.subplots(len(rows), columns, squeeze=False)
    for axes in grid.ravel():
        axes.set_axis_off()
    for row, panels in zip(grid, rows, strict=True):
        for axes, (title, image, limits) in zip(row, panels, strict=False):
            axes.imshow(image, cmap="gray", interpolation="nearest", **limits)
            axes.set_title(title, fontsize=10)
    figure.supxlabel("\n".join(numbers), fontsize=9, parse_math=False)  # names of files may hold any sign
    with atomic(path) as partial:
        figure.savefig(partial, format="png", dpi=110)


def _result_panels(frame: np.ndarray | None, estimate: np.ndarray, albedo: np.ndarray, truth: np.ndarray | None) -> list[Panel]:
    panels: list[Panel] = []
    if frame is not None:
        corner = frame[:257, :257]
        low, high = float(corner.min()), float(corner.max())
        limits = {"vmin": low, "vmax": high if high > low else low + 1.0}
        panels.append(("speckle (a corner of the first frame)", corner, limits))
    shown = centre_dimmed(estimate)
    panels.append(("autocorrelation estimate", shown, {"vmin": float(np.quantile(shown, 0.01)), "vmax": float(shown.max())}))
    panels.append(("reconstruction", albedo, _from_zero(albedo)))
    if truth is not None:
        panels.append(("truth", truth, _from_zero(truth)))
    return panels


def _posterior_panels(posterior: Posterior) -> list[Panel]:
    """Standard deviation, probability of light, and, where there are several answers, the likeliest of them."""
    count = len(posterior.samples)
    panels: list[Panel] = [(f"mean of {count} samples", posterior.mean, _from_zero(posterior.mean)),
                           ("standard deviation, 0 to 0.5", posterior.deviation, {"vmin": 0.0, "vmax": 0.5}),
                           ("probability that a pixel is bright", posterior.bright, {"vmin": 0.0, "vmax": 1.0})]
    answers = posterior.alternatives
    if len(answers) > 1:
        panels += [(f"answer {number + 1}: {100.0 * answer.probability:.0f} %", answer.albedo, _from_zero(answer.albedo))
                   for number, answer in enumerate(answers[:ALTERNATIVES_SHOWN])]
    return panels


def _from_zero(image: np.ndarray) -> dict[str, float]:
    return {"vmin": 0.0, "vmax": float(image.max()) or 1.0}


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
