"""`python -m benchmarks.constants [PACKAGE ...]`: the named numbers of the program, with value and meaning, as a table in Markdown."""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

PACKAGES = ("correlograph", "data_gen", "invert", "radiometry", "scenes", "sim")

ROOT = Path(__file__).parents[1]

MAX_VALUE_CHARACTERS = 60


class Constant(NamedTuple):
    """A named number: file, names, value as in the source, and the docstring below it."""

    file: Path
    names: tuple[str, ...]
    value: str
    meaning: str


def constants(package: str) -> Iterator[Constant]:
    """Yield the constants of a package whose value contains a number; a folder or a file relative to the repository."""
    path = ROOT / package
    for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
        body = ast.parse(file.read_text()).body
        for statement, following in zip(body, [*body[1:], None], strict=True):
            if not isinstance(statement, (ast.Assign, ast.AnnAssign)) or statement.value is None:
                continue
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            names = tuple(part.id for one in targets for part in ast.walk(one) if isinstance(part, ast.Name))
            numbers = [
                part
                for part in ast.walk(statement.value)
                if isinstance(part, ast.Constant) and isinstance(part.value, (int, float)) and not isinstance(part.value, bool)
            ]
            if numbers and names and all(name.lstrip("_").isupper() for name in names):
                yield Constant(file.relative_to(ROOT), names, ast.unparse(statement.value), _docstring(following))


def _docstring(statement: ast.stmt | None) -> str:
    """Return the text of a docstring on one line; empty for another statement."""
    if not isinstance(statement, ast.Expr) or not isinstance(statement.value, ast.Constant):
        return ""
    return " ".join(str(statement.value.value).split())


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("packages", nargs="*", default=PACKAGES, help="packages, folders or files; all by default")
    found = [one for package in parser.parse_args(argv).packages for one in constants(package)]
    print("| constant | value | meaning | file |\n|---|---|---|---|")
    for one in found:
        value = one.value if len(one.value) <= MAX_VALUE_CHARACTERS else one.value[:MAX_VALUE_CHARACTERS] + " ..."
        print(f"| {', '.join(one.names)} | `{value}` | {one.meaning.replace('|', '&#124;')} | `{one.file}` |")
    print(f"\n{sum(len(one.names) for one in found)} constants, {sum(not one.meaning for one in found)} without a docstring")


if __name__ == "__main__":
    main()
