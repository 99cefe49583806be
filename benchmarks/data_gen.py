"""`python -m benchmarks.data_gen --images DIR`: measure samples per second of each kind of dataset, with one and two workers."""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from data_gen.__main__ import main as data_gen
from scenes import scene_path

KINDS = {
    "targets": (100_000, ()),
    "noise-model pairs": (40_000, ("--measurement", "noise-model")),
    "rendered pairs": (128, ("--measurement", "render", "--scene", str(scene_path("corner_letter")))),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", required=True)
    images = parser.parse_args().images
    print("| | samples | one worker, a second | two workers, a second | 200 000 with two |\n|---|---|---|---|---|")
    for name, (count, extra) in KINDS.items():
        rates = []
        for workers in (1, 2):
            with tempfile.TemporaryDirectory() as folder:
                begin = time.perf_counter()
                arguments = ["--images", images, "--count", str(count), "--workers", str(workers), *extra]
                data_gen([str(Path(folder) / "set.zarr"), *arguments])
                rates.append(count / (time.perf_counter() - begin))
        print(f"| {name} | {count} | {rates[0]:.3g} | {rates[1]:.3g} | {200_000 / rates[1] / 60:.3g} min |")


if __name__ == "__main__":
    main()
