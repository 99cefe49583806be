"""Many captures on parallel workers, with resumption, a table and contact sheets."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from correlograph.errors import InputError
from correlograph.files.captured_frames import CONTACT_SHEET, find_frames
from correlograph.files.manifest import are_intact, claim, own_files
from correlograph.files.output import atomic, save_json
from correlograph.workers import WorkerDeath, run_tasks
from invert.albedo.metrics import aligned_pearson
from invert.batch.captures import Captures, Job
from invert.output.report import save_contact_sheet
from invert.output.result_files import RESULT_FILES, expected_files
from invert.output.truth import Truth

SHEET_CAPACITY = 60
"""Maximum number of reconstructions on one contact sheet."""


def invert_captures(
    job: Job, captures: Captures, output: Path, workers: int, scheduler: str | None, *, overwrite: bool = False
) -> None:
    """Reconstruct each capture into a folder of its name; then write table.md, captures.json and the contact sheets.

    Results do not depend on the number of workers. Raises InputError at the end if captures failed.
    """
    truth = job.check()
    _claim(captures, output, overwrite=overwrite)
    known = {name: _known(job, files, output / name) for name, files in captures.items()}
    rows = {name: {"name": name, **row} for name, row in known.items() if row is not None}
    missing = [name for name in captures if name not in rows]
    if missing:
        task = partial(_in_worker, job, output.resolve(), overwrite)
        rows |= _invert_missing(task, captures, missing, min(workers, len(missing)), scheduler)
    ordered = [rows[name] for name in captures]
    _write_table(output / "table.md", ordered)
    _save_contact_sheets(output, [row for row in ordered if "error" not in row], truth)
    save_json(output / "captures.json", {"captures": ordered})
    failed = [row for row in ordered if "error" in row]
    if failed:
        raise InputError(
            "captures",
            "captures that can be inverted",
            f"{len(failed)} of {len(ordered)} that cannot, the first {failed[0]['name']} ({failed[0]['error']})",
            f"see {output / 'table.md'}",
        )


def _claim(captures: Captures, output: Path, *, overwrite: bool) -> None:
    """Refuse output names taken by files that this program did not write, before any capture is reconstructed."""
    sheets = [_sheet_name(number) for number in range(-(-len(captures) // SHEET_CAPACITY))]
    claim(output, ["table.md", "captures.json", *sheets], overwrite=overwrite)
    for name in captures:
        folder = output / name
        if folder.is_dir() and not folder.is_symlink():
            claim(folder, RESULT_FILES, overwrite=overwrite)
        elif os.path.lexists(folder):
            raise InputError(
                "output", f"a folder, or nothing, called {name}", f"a file or a link {folder}", "rename the capture"
            )


def _sheet_name(number: int) -> str:
    return f"{CONTACT_SHEET}{f'_{number + 1}' if number else ''}.png"


def _known(job: Job, files: Sequence[Path], folder: Path) -> dict[str, Any] | None:
    """Return the table row of an earlier result with the same options and files; None if there is none."""
    try:
        summary = json.loads((folder / "result.json").read_text())
        if are_intact(folder, expected_files(summary)) and summary["request_sha256"] == job.sha256(find_frames(files)):
            return _row(summary)
    except (OSError, ValueError, KeyError, TypeError, EOFError):
        pass
    return None


def _invert_missing(
    task: Callable[[Any], dict[str, Any]], captures: Captures, names: Sequence[str], workers: int, scheduler: str | None
) -> dict[str, dict[str, Any]]:
    rows = {}
    items = [(name, captures[name]) for name in names]
    with tqdm(total=len(names), unit="capture", disable=None) as bar:
        for (name, _), row in run_tasks(task, items, workers, scheduler):
            if isinstance(row, WorkerDeath):
                row = {"error": "its workers died; give them more memory, then run the same command again"}
            rows[name] = {"name": name, **row}
            bar.update()
    return rows


def _in_worker(job: Job, output: Path, overwrite: bool, item: tuple[str, Sequence[Path]]) -> dict[str, Any]:
    name, files = item
    torch.set_num_threads(1)  # captures run in parallel processes, and sums depend on the number of threads
    try:
        return _row(job.run(files, output / name, overwrite=overwrite)[1])
    except (InputError, OSError, MemoryError, RuntimeError) as error:  # a failed capture must not stop the others
        return {"error": " ".join(str(error).split())[:300] or type(error).__name__}


def _row(summary: dict[str, Any]) -> dict[str, Any]:
    """Return the row of the table for a result."""
    noise = summary["noise"]
    row = {
        "object_found": summary["object_found"],
        "confidence": summary["confidence"],
        "floor_over_peak": noise["floor_over_peak"],
        "dof": noise["dof"],
        "warnings": summary["warnings"],
        "notes": summary["notes"],
        "pitches_m": summary["pitches_m"],
    }
    return row | ({"pearson": summary["pearson"]} if "pearson" in summary else {})


def _write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    compared = any("pearson" in row for row in rows)
    head = ["capture", "object found", "confidence", *(["correlation"] if compared else []), "floor/peak", "K", "remarks"]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for row in rows:
        if "error" in row:
            cells = [row["name"], *[""] * (len(head) - 2), row["error"]]
        else:
            numbers = [row["confidence"], *([row["pearson"]] if compared else []), row["floor_over_peak"], row["dof"]]
            cells = [
                row["name"],
                "yes" if row["object_found"] else "no",
                *("" if value is None else f"{value:.3g}" for value in numbers),
                "; ".join([*row["warnings"], *row["notes"]]),
            ]
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    with atomic(path) as partial_file:
        partial_file.write_text("\n".join(lines) + "\n")


def _save_contact_sheets(output: Path, rows: list[dict[str, Any]], truth: Truth | None) -> None:
    """Plot contact sheets of all reconstructions, registered to the truth if there is one; remove those of an earlier run."""
    for old in own_files(output):
        if old.name.startswith(CONTACT_SHEET):
            old.unlink()
    for number, begin in enumerate(range(0, len(rows), SHEET_CAPACITY)):
        part = rows[begin : begin + SHEET_CAPACITY]
        albedos = [np.load(output / row["name"] / "albedo.npy", allow_pickle=False) for row in part]
        if truth is not None:
            albedos = [
                aligned_pearson(albedo, truth.on_lags(len(albedo), row["pitches_m"]))[1]
                for albedo, row in zip(albedos, part, strict=True)
            ]
        titles = [
            f"{row['name'][:24]}\n{format(row['confidence'], '.2f') if row['object_found'] else 'no object'}" for row in part
        ]
        save_contact_sheet(output / _sheet_name(number), albedos, titles)
