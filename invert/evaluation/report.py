"""Report of an evaluation: tables, figures, accuracy against time."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.files.figures import save_figure
from correlograph.files.output import atomic, save_json
from invert.albedo.metrics import bootstrap_error
from invert.evaluation.cells import Cell

SCORES = ("pearson", "ssim", "iou", "edge_f1", "psnr_db", "success", "agreement", "nats", "recognised")

LEAD_SCORES = ("pearson", "ssim", "iou")
"""Scores for which the lead of the first method is reported."""


def figure_name(test_set: str) -> str:
    """Return the name of the figure of a test set."""
    return f"{test_set.replace(',', '').replace(' ', '_')}.png"


def write_report(output: Path, results: list[Cell]) -> None:
    """Write table.md, results.json, one figure per test set and pareto.png."""
    summary, leads = [_summary(result) for result in results], _leads(results)
    with atomic(output / "table.md") as partial:
        partial.write_text(_tables(summary, leads))
    for test_set in dict.fromkeys(entry["set"] for entry in summary):
        chosen = [result for result in results if result.asked["set"] == test_set]
        _save_panels(output / figure_name(test_set), chosen)
    _save_pareto(output / "pareto.png", summary)
    save_json(output / "results.json", {"summary": summary, "leads": leads})


def _summary(result: Cell) -> dict[str, Any]:
    """Return the means over the cases of a cell, each with its bootstrap error (None for a single case)."""
    rows, asked = result.rows, result.asked
    scores = {}
    for name in SCORES:
        if all(name in row for row in rows):
            values = np.array([row[name] for row in rows], float)
            scores[name] = {"mean": float(values.mean()), "error": bootstrap_error(values) if len(rows) > 1 else None}
    return {
        "set": asked["set"],
        "level": asked["level"],
        "method": asked["method"],
        "cases": len(rows),
        "confidence_error": float(np.mean([abs(row["confidence"] - row["pearson"]) for row in rows])),
        "confidence_excess": float(max(row["confidence"] - row["pearson"] for row in rows)),
        "seconds": float(np.median([row["seconds"] for row in rows])),
        **scores,
    }


def _leads(results: list[Cell]) -> list[dict[str, Any]]:
    """Return mean score differences between the first method and each other, computed image by image, because scores vary
    more between images than between methods.
    """
    rows = {(result.asked["set"], result.asked["level"], result.asked["method"]): result.rows for result in results}
    first = results[0].asked["method"]
    leads = []
    for (test_set, level, method), others in rows.items():
        if method == first or len(others) == 1:
            continue
        ours = rows[test_set, level, first]
        entry: dict[str, Any] = {"set": test_set, "level": level, "method": method}
        for name in LEAD_SCORES:
            values = np.array([own[name] - other[name] for own, other in zip(ours, others, strict=True)])
            entry[name] = {"mean": float(values.mean()), "error": bootstrap_error(values)}
        leads.append(entry)
    return leads


def _format_score(score: dict[str, Any] | None) -> str:
    if score is None:
        return ""
    error = "" if score["error"] is None else f" ± {score['error']:.1g}"
    digits = ".0f" if abs(score["mean"]) >= 100.0 else ".3g"
    return f"{score['mean']:{digits}}{error}"


def _tables(summary: list[dict[str, Any]], leads: list[dict[str, Any]]) -> str:
    """Return one Markdown table per test set and score: methods in rows, levels in columns; below them the mean score
    advantages of the first method.
    """
    parts = []
    for test_set in dict.fromkeys(entry["set"] for entry in summary):
        entries = [entry for entry in summary if entry["set"] == test_set]
        levels = list(dict.fromkeys(entry["level"] for entry in entries))
        by_method: dict[str, dict[str, Any]] = defaultdict(dict)
        for entry in entries:
            by_method[entry["method"]][entry["level"]] = entry
        parts.append(f"## {test_set}, {entries[0]['cases']} images per level\n")
        for name in SCORES:
            if not any(name in entry for entry in entries):
                continue
            parts.append(f"**{name}**\n\n| method | {' | '.join(levels)} |\n|---|{'---|' * len(levels)}")
            for method, row in by_method.items():
                cells = [_format_score(row[level].get(name)) for level in levels]
                parts.append(f"| {method} | {' | '.join(cells)} |")
            lead: dict[str, list[str]] = defaultdict(list)
            for entry in leads:
                if entry["set"] == test_set and name in entry:
                    lead[entry["method"]].append(f"{entry[name]['mean']:+.3f} ± {entry[name]['error']:.1g}")
            parts += [f"| lead over {method} | {' | '.join(cells)} |" for method, cells in lead.items()]
            parts.append("")
        seconds = ", ".join(
            f"{method} {np.median([entry['seconds'] for entry in row.values()]):.2g}" for method, row in by_method.items()
        )
        errors = ", ".join(
            f"{method} {np.mean([entry['confidence_error'] for entry in row.values()]):.3f}, largest excess "
            f"{max(entry['confidence_excess'] for entry in row.values()):.2f}"
            for method, row in by_method.items()
        )
        parts.append(f"Seconds per image: {seconds}. Mean difference of confidence and correlation: {errors}.\n")
    return "\n".join(parts)


def _save_panels(path: Path, results: list[Cell]) -> None:
    """Plot the first case of each level: the truth on top, one row per method."""
    from matplotlib.figure import Figure

    from invert.albedo.metrics import aligned_pearson

    levels = list(dict.fromkeys(result.asked["level"] for result in results))
    methods = list(dict.fromkeys(result.asked["method"] for result in results))
    figure = Figure(figsize=(1.5 * len(levels) + 0.4, 1.6 * (len(methods) + 1)), layout="constrained")
    grid = figure.subplots(len(methods) + 1, len(levels), squeeze=False)
    for axes in grid.flat:
        axes.set_xticks([])
        axes.set_yticks([])
    for result in results:
        column, row = levels.index(result.asked["level"]), methods.index(result.asked["method"]) + 1
        truth = result.truths[0]
        pearson, moved = aligned_pearson(result.albedos[0], truth)
        grid[0, column].imshow(truth, cmap="gray", interpolation="nearest")
        grid[0, column].set_title(result.asked["level"], fontsize=8)
        grid[row, column].imshow(moved, cmap="gray", interpolation="nearest", vmin=0.0)
        grid[row, column].set_xlabel(f"{pearson:.2f}", fontsize=8)
        grid[row, 0].set_ylabel(result.asked["method"], fontsize=8)
    grid[0, 0].set_ylabel("reference" if results[0].asked["set"].startswith("measured") else "truth", fontsize=8)
    save_figure(path, figure, 100)


def _save_pareto(path: Path, summary: list[dict[str, Any]]) -> None:
    """Plot the mean correlation over the levels of each set against seconds per image."""
    from matplotlib.figure import Figure

    sets = list(dict.fromkeys(entry["set"] for entry in summary))
    figure = Figure(figsize=(4.2 * len(sets), 3.6), layout="constrained")
    for axes, test_set in zip(figure.subplots(1, len(sets), squeeze=False)[0], sets, strict=True):
        for method in dict.fromkeys(entry["method"] for entry in summary):
            chosen = [entry for entry in summary if (entry["set"], entry["method"]) == (test_set, method)]
            if chosen:
                seconds = float(np.median([entry["seconds"] for entry in chosen]))
                pearson = float(np.mean([entry["pearson"]["mean"] for entry in chosen]))
                axes.plot(seconds, pearson, "o")
                axes.annotate(method, (seconds, pearson), fontsize=8, xytext=(3, 3), textcoords="offset points")
        axes.set_xscale("log")
        axes.set_xlabel("seconds per image")
        axes.set_ylabel("registered correlation, mean over levels")
        axes.set_title(test_set, fontsize=9)
    save_figure(path, figure, 100)
