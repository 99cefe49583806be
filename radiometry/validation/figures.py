"""Pictures of the validation: the paper's Figs. 4 and 5, and the lab's floor against exposure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from correlograph.files.figures import save_figure

_MARKERS = {"rendered": "o", "measured": "x"}


def _save(figure: Any, path: Path) -> None:
    save_figure(path, figure)


def draw_statistics(path: Path, result: dict[str, Any]) -> None:
    """Draw Fig. 5: variance against mean of the lags without signal for a fixed number N of patches, and variance over mean
    squared against 1 / N.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, marker in _MARKERS.items():
        if name not in result:
            continue
        exposure, patches = result[name]["exposure"], result[name]["patches"]
        left.loglog([c["mean"] for c in exposure], [c["variance"] for c in exposure], marker, mfc="none", label=name)
        right.loglog(
            [1 / c["dof"] for c in patches], [c["variance"] / c["mean"] ** 2 for c in patches], marker, mfc="none", label=name
        )
    mean, predicted = np.geomspace(*left.get_xlim(), 20), result["rendered"]["predicted"]
    left.loglog(mean, predicted * mean**2, "k-", lw=1, label=f"predicted: mean$^2$ / {1 / predicted:.0f}")
    inverse = np.geomspace(1 / 70, 1.1, 20)
    right.loglog(inverse, inverse, "k-", lw=1, label="predicted: 1 / N")
    left.set(xlabel="mean of the corner (of 255)", ylabel="variance", title="2 frames, exposure varies")
    right.set(xlabel="1 / N", ylabel="variance / mean$^2$", title="N = patches x (frames - 1) varies")
    for axes in (left, right):
        axes.legend(frameon=False)
    _save(figure, path)


def draw_budget(path: Path, estimates: list[tuple[str, np.ndarray]]) -> None:
    """Fig. 4: estimates from one total exposure that is divided into different numbers of frames, each on its own scale,
    floor included.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.4 * len(estimates), 3.6), layout="constrained")
    for index, (title, estimate) in enumerate(estimates):
        axes = figure.add_subplot(1, len(estimates), index + 1)
        shown = np.array(estimate)
        shown[63, 63] = np.sort(shown.ravel())[-2]
        axes.imshow(shown, cmap="gray", vmin=0.0, vmax=float(shown.max()))
        axes.set(title=title, xticks=[], yticks=[])
    _save(figure, path)


def draw_floor(path: Path, floor: dict[str, Any], ideal_s: float | None) -> None:
    """The lab's floor over peak against exposure, its fit a / t + c, and the ideal shot noise."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 4.2), layout="constrained")
    axes = figure.add_subplot()
    points = floor["points"]
    axes.loglog([p["exposure_s"] for p in points], [p["floor_over_peak"] for p in points], "x", label="lab, another 7")
    t = np.geomspace(min(p["exposure_s"] for p in points), max(p["exposure_s"] for p in points), 50)
    axes.loglog(t, floor["a_s"] / t + floor["c"], "k-", lw=1, label=f"{floor['a_s']:.3f} s / t + {floor['c']:.3f}")
    if ideal_s is not None:
        axes.loglog(t, ideal_s / t, "k:", lw=1, label=f"ideal shot noise, {ideal_s:.4f} s / t")
    axes.set(xlabel="exposure (s)", ylabel="floor over peak")
    axes.legend(frameon=False)
    _save(figure, path)
