"""`python -m benchmarks.quoted_numbers [--check]`: write the numbers that README and docs quote, or check them.

A quoted number is followed by the comment `<!--name-->`, and `NUMBERS` computes it. With `--check`, numbers that differ are listed and
the exit status is 1.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import correlograph as cg
from radiometry.light_budget_rows import Budget, light_budget
from radiometry.prediction import Prediction, predict

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
MARKER = re.compile(r"(-?[\d.]+)(<!--(\w+)-->)")
SCENE = "corner_letter"


@cache
def prediction() -> Prediction:
    """Return the prediction of the reference scene."""
    return predict(cg.load(SCENE).geometry)


@cache
def budget() -> Budget:
    """Return the light budget of the reference scene."""
    return light_budget(cg.load(SCENE).geometry.light_path)


@cache
def demo_correlation() -> float:
    """Return the correlation that `make demo` prints, rounded down to a tenth: processors with and without bfloat16 differ by 0.01."""
    capture = cg.render(SCENE, frames=2, seed=1)
    return math.floor(10.0 * cg.reconstruct(capture).compare(cg.Truth.of(capture)).pearson) / 10.0


def cell_um(axis: int) -> float:
    """Return the cell of a field along rows (0) or columns (1): a lag times patch over frame."""
    grid = prediction().grid
    return 1e6 * prediction().pitches_m[axis] * grid.patch_shape[axis] / grid.frame_shape[axis]


NUMBERS: dict[str, Callable[[], str]] = {
    "per_pixel_db": lambda: f"{budget().per_pixel_db:.2f}",
    "per_frame_db": lambda: f"{budget().per_frame_db:.2f}",
    "photoelectrons_million": lambda: f"{1e-6 * budget().photoelectrons_per_frame_s:.2f}",
    "demo_correlation": lambda: f"{demo_correlation():.1f}",
    "cell_rows_um": lambda: f"{cell_um(0):.0f}",
    "cell_columns_um": lambda: f"{cell_um(1):.0f}",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing")
    options = parser.parse_args()
    texts = {page: page.read_text() for page in PAGES}
    names = {name for text in texts.values() for _, _, name in MARKER.findall(text)}
    computed, differing = {name: NUMBERS[name]() for name in sorted(names)}, []
    for page, text in texts.items():
        for number, _, name in MARKER.findall(text):
            if number != computed[name]:
                differing.append(f"{page.name}: {name} is {computed[name]}, not {number}")
        if not options.check:
            page.write_text(MARKER.sub(lambda found: computed[found[3]] + found[2], text))
    print("\n".join(differing) or "all quoted numbers are those that the program computes")
    sys.exit(bool(differing) and options.check)


if __name__ == "__main__":
    main()
