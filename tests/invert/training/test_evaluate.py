"""The evaluation command: complete, resumable, honest about what it cannot compare."""

import json

import numpy as np
import pytest

from invert.evaluation.cells import Cell
from invert.evaluation.evaluate import main
from invert.evaluation.report import _leads, _summary, _tables

PICTURES = np.zeros((1, 64, 64))


@pytest.fixture
def small(tmp_path) -> list:
    return ["-o", tmp_path / "out", "--sets", "shapes", "--methods", "hio:fast", "er:fast", "--count", 3, "--levels", 2]


def test_tables_pictures_and_json(tmp_path, command, small):
    code, _, err = command(main, *small)
    assert code == 0, err
    table = (tmp_path / "out" / "table.md").read_text()
    assert "| hio:fast |" in table
    assert "b 80, K 64" in table
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    summary, leads = results["summary"], results["leads"]
    assert len(summary) == 4
    assert [(lead["level"], lead["method"]) for lead in leads] == [(entry["level"], "er:fast") for entry in summary[1::2]]
    for lead, ours, other in zip(leads, summary[::2], summary[1::2], strict=True):
        assert lead["iou"]["mean"] == pytest.approx(ours["iou"]["mean"] - other["iou"]["mean"])
    assert "| lead over er:fast |" in table
    first = summary[0]
    assert 0.0 < first["pearson"]["mean"] <= 1.0
    assert first["pearson"]["error"] > 0.0
    for name in ("shapes.png", "pareto.png"):
        assert (tmp_path / "out" / name).stat().st_size > 5000
    cell = tmp_path / "out" / "cells"
    stored = {file: file.stat().st_mtime_ns for file in cell.iterdir()}
    albedos = next(file for file in sorted(cell.glob("*er-fast*.npy")) if "-truth" not in file.name)
    changed = np.load(albedos)
    changed[0, 20, 30] += 0.5
    np.save(albedos, changed)
    code, _, error = command(main, *small)
    assert code == 2
    assert "--overwrite" in error
    assert command(main, *small, "--overwrite")[0] == 0
    redone = [file for file in cell.glob("[!.]*") if stored.get(file) != file.stat().st_mtime_ns]
    assert {"er-fast" in file.name for file in redone} == {True}
    assert json.loads((tmp_path / "out" / "results.json").read_text())["summary"][1]["pearson"] == summary[1]["pearson"]


def test_a_score_that_some_levels_lack_leaves_gaps():
    """Only captures with others beside them are judged by these, and only where something was drawn."""
    rows = {"seconds": 1.0, "confidence": 0.5, "pearson": 0.5}
    results = [
        Cell({"set": "measured 7", "level": level, "method": "hio"}, [rows | more], PICTURES, PICTURES)
        for level, more in (("1 s", {}), ("0.5 s", {"nats": -1234.5}))
    ]
    table = _tables([_summary(result) for result in results], _leads(results))
    assert "**nats**\n\n| method | 1 s | 0.5 s |\n|---|---|---|\n| hio |  | -1234 |" in table


@pytest.mark.slow
def test_measured_files_have_references(tmp_path, command, measured):
    arguments = ("--sets", "measured", "--measured", measured, "--methods", "hio:fast", "--levels", 1)
    code, _, err = command(main, "-o", tmp_path, *arguments)
    assert code == 0, err
    rows = json.loads(next((tmp_path / "cells").glob("*.json")).read_text())["rows"]
    assert rows[0]["agreement"] > 0.7
    assert np.isfinite(rows[0]["nats"])
    assert np.load(next((tmp_path / "cells").glob("*-truth.npy"))).shape == (1, 64, 64)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--sets", "edges"], "--images"),
        (["--sets", "measured"], "--measured"),
        (["--methods", "magic"], "--methods"),
        (["--methods", "hio:perfect"], "--methods"),
        (["--weights", "paper"], "--weights"),
        (["--count", 0], "--count"),
        (["--sets", "edges", "--images", "nowhere"], "--images"),
    ],
)
def test_bad_input(tmp_path, command, arguments, text):
    code, _, err = command(main, "-o", tmp_path, *arguments)
    assert code == 2
    assert text in err
    assert len(err.strip().splitlines()) == 1
