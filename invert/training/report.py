"""Learning curve of a training run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from correlograph.files.figures import save_figure


def save_curve(path: Path, curve: list[dict[str, Any]], measure: str, labels: list[str]) -> None:
    """Plot a measure for each validation level, by its label, against training time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.add_subplot()
    for index, label in enumerate(labels):
        axes.plot([point["seconds"] / 60.0 for point in curve], [point["validation"][index] for point in curve], label=label)
    axes.set_xlabel("minutes")
    axes.set_ylabel(f"{measure}, validation")
    axes.legend(fontsize=8)
    save_figure(path, figure)
