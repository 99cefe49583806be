"""The report: frame, autocorrelation estimate, reconstruction, truth, and posterior in one figure."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from correlograph.files.figures import add_scale_bar, save_figure
from correlograph.files.output import atomic
from invert.albedo.posterior import Samples
from invert.albedo.registration import register_groups
from invert.assess.hypotheses import describe
from invert.field.reconstruction import FieldReconstruction
from invert.output.outcome import Outcome
from invert.output.truth import Comparison
from radiometry.noise.measured_noise import dim_zero_lag

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


CLUSTERS_SHOWN = 2
"""Number of clusters of samples that fit into the report."""
BRIGHT_QUANTILE = 0.998
"""Quantile of a speckled image that is plotted white."""
FRAME_CORNER = 257
"""Side of the part of the frame that the report shows, in pixels."""
LINE_WIDTH = 110
"""Characters per line of text below the panels."""


@dataclass(frozen=True)
class _Panel:
    """One image of the report: title, limits of its grey scale, pixel pitch in metres, and unit of its axes."""

    title: str
    image: np.ndarray
    low: float
    high: float
    pitch_m: float | None = None
    unit: str = "lags"
    extent: tuple[float, float, float, float] | None = None


def save_image(path: Path, image: np.ndarray, scale: int = 8) -> None:
    """Write an 8-bit grey-scale PNG file, maximum white, with enlarged pixels."""
    from PIL import Image

    top = float(image.max())
    grey = np.round(np.clip(image / top if top > 0.0 else image, 0.0, 1.0) * 255.0).astype(np.uint8)
    with atomic(path) as partial:
        Image.fromarray(np.kron(grey, np.ones((scale, scale), np.uint8))).save(partial, format="PNG")


def draw_report(result: Outcome, comparison: Comparison | None = None) -> Figure:
    """Plot the panels of a result, the posterior in a second row, and its numbers and warnings below.

    Args:
        comparison: known albedo and the registered reconstruction; samples are registered to the albedo from the autocorrelation.
    """
    from matplotlib.figure import Figure

    albedo, samples, pearson, truth = result.albedo, result.samples, None, None
    if comparison is not None:
        pearson, albedo, truth = comparison.pearson, comparison.albedo, comparison.truth
        samples = samples and samples.register_to(result.coarse_albedo if result.fields else albedo)
    pitch_m = None if result.pitches_m is None else result.pitches_m[1]
    rows = [_result_panels(result, albedo, truth, pitch_m)]
    lag_pitch_m = None if result.estimate.pitches_m is None else result.estimate.pitches_m[1]
    if result.fields is not None:
        rows.append(_field_panels(result.fields, result.coarse_albedo, albedo, pitch_m))
    if samples is not None:
        rows.append(_posterior_panels(samples, lag_pitch_m))
    lines = report_lines(result, pearson)
    columns = max(map(len, rows))
    drawing = result.estimate.drawing
    count = len(rows) + (drawing is not None)
    figure = Figure(figsize=(3.7 * columns, 3.5 * count + 0.3 + 0.17 * len(lines)), layout="constrained")
    parts = figure.subfigures(count, 1, squeeze=False)[:, 0]
    for part, panels in zip(parts, rows, strict=False):
        for axes, panel in zip_longest(part.subplots(1, columns), panels):
            if panel is None:
                axes.set_axis_off()
            else:
                _draw_panel(part, axes, panel)
    if drawing is not None:
        drawing.draw(parts[-1], "scene")
    figure.supxlabel("\n".join(lines), fontsize=9, parse_math=False, ha="left", x=0.02)  # file names may contain any sign
    return figure


def _draw_panel(figure: SubFigure, axes, panel: _Panel) -> None:  # type: ignore[no-untyped-def]
    image = axes.imshow(panel.image, cmap="gray", interpolation="nearest", vmin=panel.low, vmax=panel.high, extent=panel.extent)
    axes.set_title("\n".join(textwrap.wrap(panel.title, 34)), fontsize=10)
    axes.tick_params(labelsize=7)
    axes.set_xlabel(panel.unit, fontsize=8)
    figure.colorbar(image, ax=axes, shrink=0.75, pad=0.02).ax.tick_params(labelsize=7)
    if panel.pitch_m is not None:
        add_scale_bar(axes, panel.pitch_m, panel.image.shape[1], panel.image.shape[0])


def _result_panels(result: Outcome, albedo: np.ndarray, truth: np.ndarray | None, pitch_m: float | None) -> list[_Panel]:
    estimate, panels = result.estimate, []
    if estimate.frame is not None:
        corner = estimate.frame[:FRAME_CORNER, :FRAME_CORNER]
        low, high = float(corner.min()), float(corner.max())
        panels.append(_Panel("corner of the first frame", corner, low, max(high, low + 1e-12), unit="pixels"))
    lags = dim_zero_lag(estimate.values)
    edge = estimate.lag_grid.lags + 0.5
    panels.append(
        _Panel(
            "autocorrelation estimate",
            lags,
            float(np.quantile(lags, 0.01)),
            float(lags.max()),
            extent=(-edge, edge, edge, -edge),
        )
    )
    title = "reconstructed albedo" if result.fields is None else "albedo from fields"
    unit = "lags" if result.fields is None else "pixels"
    panels.append(_albedo_panel(title, albedo, pitch_m, unit))
    if truth is not None:
        panels.append(_albedo_panel("true albedo", truth, pitch_m, unit))
    return panels


def _field_panels(
    fields: FieldReconstruction, coarse: np.ndarray, registered: np.ndarray, pitch_m: float | None
) -> list[_Panel]:
    """Plot the coarse albedo, the mean intensity of the fields before despeckling, and the standard deviation of the albedo.

    Args:
        registered: the fine albedo as the report shows it; these images are registered in the same way.
    """
    enlarged = np.kron(coarse, np.ones((fields.cells_per_lag, fields.cells_per_lag), coarse.dtype))
    images = {
        "coarse albedo": enlarged,
        "mean intensity of the fields": fields.intensity,
        "standard deviation of the albedo": fields.deviation,
    }
    known = {title: image for title, image in images.items() if image is not None}
    group = torch.from_numpy(np.stack([fields.albedo, *known.values()]).astype(np.float32))
    moved = register_groups(group[None], torch.from_numpy(np.ascontiguousarray(registered, np.float32))[None])[0, 1:]
    return [
        _Panel(title, image, 0.0, float(np.quantile(image, BRIGHT_QUANTILE)) or 1.0, pitch_m, unit="pixels")
        for title, image in zip(known, moved.numpy(), strict=True)
    ]


def _posterior_panels(samples: Samples, pitch_m: float | None) -> list[_Panel]:
    """Plot mean, standard deviation, probability of bright pixels, and the most probable clusters if there are several."""
    panels = [
        _albedo_panel(f"mean of {len(samples)} samples", samples.mean, pitch_m),
        _Panel("standard deviation", samples.deviation, 0.0, 0.5, pitch_m),
        _Panel("probability of a bright pixel", samples.bright, 0.0, 1.0, pitch_m),
    ]
    clusters = samples.clusters
    if len(clusters) > 1:
        panels += [
            _albedo_panel(f"cluster {number + 1}: {100.0 * cluster.probability:.0f} %", cluster.albedo, pitch_m)
            for number, cluster in enumerate(clusters[:CLUSTERS_SHOWN])
        ]
    return panels


def _albedo_panel(title: str, albedo: np.ndarray, pitch_m: float | None, unit: str = "lags") -> _Panel:
    return _Panel(title, albedo, 0.0, float(albedo.max()) or 1.0, pitch_m, unit)


def report_lines(result: Outcome, pearson: float | None) -> list[str]:
    """Return the lines of text of a report, of `LINE_WIDTH` characters at most: input, finding, numbers, every warning."""
    measurement, settings = result.measurement, result.settings
    found = "object found" if result.object_found else "NO OBJECT FOUND"
    if result.object_found:
        found = f"{found}, confidence {result.confidence:.2f}"
    floor = measurement.floor_over_peak
    dof = measurement.noise.dof if measurement.noise.dof_read else None
    parts = [
        f"floor/peak {floor:.3g}" if floor is not None else "floor/peak unknown",
        f"K {dof:.3g}" if dof is not None else "K unknown",
    ]
    if result.estimate.pitches_m is not None:
        parts.append(f"{result.estimate.pitches_m[0] * 1e6:.0f} um per lag")
    if result.fields is not None:
        parts.append(result.fields.describe(result.estimate.pitches_m))
    if pearson is not None:
        parts.append(f"correlation with the truth {pearson:.2f}")
    parts.append(f"{settings.method}:{settings.quality}, {result.seconds_total:.1f} s")
    told = [describe(result.hypotheses)] if result.hypotheses else []
    remarks = [*(f"warning: {warning}" for warning in result.warnings), *(f"note: {note}" for note in result.notes)]
    names = textwrap.wrap(result.estimate.name, LINE_WIDTH, max_lines=2, placeholder=" ...")
    texts = [found, ", ".join(parts), *told, *remarks]
    return names + [line for text in texts for line in textwrap.wrap(text, LINE_WIDTH)]


def save_contact_sheet(path: Path, albedos: Sequence[np.ndarray], titles: Sequence[str]) -> None:
    """Plot reconstructions (64, 64) on a contact sheet, ten per row, each below its title."""
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
    save_figure(path, figure)
