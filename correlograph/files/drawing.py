"""Drawing of a scene to scale, as numbers: a rendered capture carries it from the scene to the report."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

MAX_POINTS = 10_000
"""Maximum number of points of a line that is read from a file."""


@dataclass(frozen=True)
class Line:
    """A line or the outline of a shape in one view.

    Attributes:
        x, y: points in metres.
        label: name of the shape, or entry of the legend; one that begins with an underscore has no entry.
        colour, style, width: arguments of matplotlib; a style that is a marker shows points.
        is_filled: whether the line is the outline of a shape, which is filled and named.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]
    label: str
    colour: str
    style: str = "-"
    width: float = 1.0
    is_filled: bool = False


@dataclass(frozen=True)
class SceneDrawing:
    """Drawing of a scene to scale, from above and from the side."""

    views: tuple[tuple[Line, ...], tuple[Line, ...]]

    def as_json(self) -> list[list[dict[str, Any]]]:
        """Return the drawing for sim.json."""
        return [[asdict(line) for line in view] for view in self.views]

    @classmethod
    def from_json(cls, content: object) -> SceneDrawing | None:
        """Return the drawing of a sim.json, None for anything else."""
        if not isinstance(content, list) or len(content) != 2 or not all(isinstance(view, list) for view in content):
            return None
        first, second = ([_read_line(line) for line in view] for view in content)
        if None in first or None in second:
            return None
        return cls((tuple(filter(None, first)), tuple(filter(None, second))))

    def draw(self, figure: Figure | SubFigure, name: str) -> None:
        """Draw both views to scale, with a legend."""
        views = figure.subplots(1, 2)
        for axes, lines, title in zip(views, self.views, ("from above", "from the side"), strict=True):
            for number, line in enumerate(lines):
                _draw_line(axes, line, number)
            axes.set_title(f"{name} {title}", fontsize=10)
            axes.set_aspect("equal", adjustable="datalim")
            axes.margins(0.12)
            axes.grid(color="0.9", lw=0.5)
            axes.set_xlabel("m")
            axes.set_ylabel("m")
        handles, labels = views[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)

    def plot(self, name: str) -> Figure:
        """Return a figure of the drawing."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(12.0, 5.6), layout="constrained")
        self.draw(figure, name)
        return figure


def _draw_line(axes: Axes, line: Line, number: int) -> None:
    if line.is_filled:
        axes.fill(line.x, line.y, color=line.colour, alpha=0.15, lw=0)
        axes.plot(line.x, line.y, color=line.colour, lw=line.width)
        middle = (sum(line.x[:-1]) / max(len(line.x) - 1, 1), sum(line.y[:-1]) / max(len(line.y) - 1, 1))
        below = 5 if number % 2 else -11
        axes.annotate(line.label, middle, fontsize=8, color=line.colour, xytext=(4, below), textcoords="offset points")
    else:
        axes.plot(line.x, line.y, line.style, color=line.colour, lw=line.width, ms=6, label=line.label)


STYLES = ("-", "--", ":", "*", "s")
COLOURS = ("tab:green", "tab:blue", "tab:red", "tab:orange", "0.35", "0.6", "k")


def _read_line(content: object) -> Line | None:
    """Return a line of a plan in sim.json, None for anything else. The file is checked because others may have changed it."""
    if not isinstance(content, dict) or set(content) != {"x", "y", "label", "colour", "style", "width", "is_filled"}:
        return None
    x, y, width = content["x"], content["y"], content["width"]
    numbers = [*x, *y, width] if isinstance(x, list) and isinstance(y, list) else [None]
    is_numeric = len(numbers) < MAX_POINTS and all(type(one) in (int, float) and math.isfinite(one) for one in numbers)
    is_known = content["style"] in STYLES and content["colour"] in COLOURS
    if not is_numeric or not is_known or not x or len(x) != len(y) or not isinstance(content["label"], str):
        return None
    label = content["label"][:80].replace("$", "")
    return Line(tuple(x), tuple(y), label, content["colour"], content["style"], width, bool(content["is_filled"]))
