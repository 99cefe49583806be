"""Figures: saving without partial files, showing, scale bars."""

from __future__ import annotations

import base64
import io
import math
from pathlib import Path
from typing import TYPE_CHECKING

from correlograph.files.output import atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BAR_FRACTION = 0.35
"""Maximum length of a scale bar as a fraction of the image width."""


def save_figure(path: Path, figure: Figure, dpi: int = 110) -> None:
    """Write a figure as a PNG file enlarged where necessary so that no text is cut off."""
    with atomic(path) as partial:
        figure.savefig(partial, format="png", dpi=dpi, bbox_inches="tight", pad_inches=0.1)


def show_figure(figure: Figure) -> None:
    """Open a figure in a window, or below a notebook cell, with the backend that matplotlib selects."""
    import matplotlib.pyplot as plt
    from matplotlib.image import imread

    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, bbox_inches="tight")
    stream.seek(0)
    window = plt.figure(figsize=figure.get_size_inches(), layout="constrained")
    axes = window.add_subplot()
    axes.imshow(imread(stream))
    axes.set_axis_off()
    plt.show()


def figure_as_html(figure: Figure, caption: str) -> str:
    """Return a figure and its caption as HTML for a notebook."""
    from html import escape

    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=80, bbox_inches="tight")
    data = base64.b64encode(stream.getvalue()).decode()
    return f'<figure><img src="data:image/png;base64,{data}"><figcaption>{escape(caption)}</figcaption></figure>'


def nice_length(limit: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that does not exceed a limit."""
    decade = 10.0 ** math.floor(math.log10(limit))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= limit * (1.0 + 1e-9))


def length_label(length_m: float) -> str:
    """Return a length with a suitable unit."""
    for unit, metres in (("m", 1.0), ("mm", 1e-3), ("um", 1e-6)):
        if length_m >= metres:
            return f"{length_m / metres:g} {unit}"
    return f"{length_m / 1e-9:g} nm"


def add_scale_bar(axes: Axes, pitch_m: float, width: int, height: int) -> None:
    """Draw a scale bar into an image of `width` x `height` pixels that are `pitch_m` metres apart."""
    length_m = nice_length(BAR_FRACTION * width * pitch_m)
    left, bottom, length = 0.05 * width, 0.94 * height, length_m / pitch_m
    axes.plot([left, left + length], [bottom, bottom], color="w", lw=3, solid_capstyle="butt")
    axes.text(
        left + 0.5 * length, bottom - 0.02 * height, length_label(length_m), color="w", ha="center", va="bottom", fontsize=8
    )
