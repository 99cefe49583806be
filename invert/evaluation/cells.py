"""Results of one method at one noise level on disk: scores, albedos and truths."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.files.output import save_array, save_json

FORMAT = 2
"""Version of the files; cells of another version are computed again."""


@dataclass(frozen=True)
class Cell:
    """Settings with which a cell was evaluated, one row of scores per test case, and the albedos and truths (cases, 64, 64)."""

    asked: dict[str, Any]
    rows: list[dict[str, Any]]
    albedos: np.ndarray
    truths: np.ndarray


def write_cell(folder: Path, cell: Cell) -> None:
    """Write the arrays first, and last the JSON with their SHA-256."""
    file = _stem(folder, cell.asked)
    for name, array in _arrays(cell).items():
        save_array(_array_file(file, name), array)
    digests = {name: _sha256(array) for name, array in _arrays(cell).items()}
    save_json(file.with_suffix(".json"), {"format": FORMAT, "asked": cell.asked, "rows": cell.rows, "sha256": digests})


def read_cell(folder: Path, asked: dict[str, Any]) -> Cell | None:
    """Return the cell with the arguments `asked`; None if it is missing, damaged, of another format or has other arguments."""
    file = _stem(folder, asked)
    try:
        known = json.loads(file.with_suffix(".json").read_text())
        arrays = {name: np.load(_array_file(file, name), allow_pickle=False) for name in ("albedos", "truths")}
        cell = Cell(known["asked"], known["rows"], **arrays)
        whole = (
            known["format"] == FORMAT
            and cell.asked == asked
            and len(cell.rows) == len(asked["cases"])
            and known["sha256"] == {name: _sha256(array) for name, array in arrays.items()}
        )
    except (OSError, ValueError, KeyError, TypeError, EOFError):
        return None
    return cell if whole else None


def _stem(folder: Path, asked: dict[str, Any]) -> Path:
    """Return the file name without suffix; the digest separates methods whose names differ only in punctuation."""
    name = asked["method"]
    plain = "".join(letter if letter.isalnum() else "-" for letter in f"{asked['set']} {asked['level']} {name}")
    return folder / f"{plain}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def _arrays(cell: Cell) -> dict[str, np.ndarray]:
    return {"albedos": cell.albedos, "truths": cell.truths}


def _array_file(file: Path, name: str) -> Path:
    return file.with_name(file.name + {"albedos": ".npy", "truths": "-truth.npy"}[name])


def _sha256(array: np.ndarray) -> str:
    return hashlib.sha256(f"{array.dtype} {array.shape}".encode() + array.tobytes()).hexdigest()
