"""`python -m benchmarks.ablation DATASET [-o docs/figures]`: compare the losses and mappings of the paper's sections 5.B and
5.C with a small network.

Each run trains the paper's U-net at a quarter of its width with the paper's noise and the same steps and seed. Writes a
table and curves.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from invert.training.losses import LOSSES
from invert.training.train import main as train
from invert.training.training_loop import VALIDATION

STEPS, EVERY = 240, 40
POINTS = 1, 2
"""Validation levels of the table, b 80 / 255, K 64 and 16; the first is that of the curves."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/figures"))
    options = parser.parse_args()
    runs = [(loss, "paper") for loss in LOSSES] + [("autocorrelation-l1", "paper-modulus"), ("registered", "paper-modulus")]
    curves = {}
    with tempfile.TemporaryDirectory() as folder:
        for loss, network in runs:
            output = Path(folder) / f"{network}-{loss}.safetensors"
            train(
                [
                    options.dataset,
                    "-o",
                    str(output),
                    "--network",
                    network,
                    "--width",
                    "16",
                    "--loss",
                    loss,
                    "--noise",
                    "paper",
                    "--steps",
                    str(STEPS),
                    "--batch",
                    "16",
                    "--checkpoint-every",
                    str(EVERY),
                ]
            )
            curves[f"{loss}, from {'|F(r)|' if network == 'paper-modulus' else 'r*r'}"] = json.loads(
                output.with_suffix(".json").read_text()
            )["curve"]
    levels = " | ".join(f"b {255 * VALIDATION[point][0]:.0f}/255, K {VALIDATION[point][1]:g}" for point in POINTS)
    print(f"Correlation after {STEPS} steps of 16:\n\n| loss, mapping | {levels} |\n|---|{'---|' * len(POINTS)}")
    for name, curve in sorted(curves.items(), key=lambda item: -item[1][-1]["validation"][POINTS[0]]):
        reached = (f"{curve[-1]['validation'][point]:.3f}" for point in POINTS)
        print(f"| {name} | {' | '.join(reached)} |")
    _draw(curves, options.output / "ablation.png")


def _draw(curves: dict[str, list], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    for name, curve in curves.items():
        axes.plot(
            [point["step"] for point in curve],
            [point["validation"][POINTS[0]] for point in curve],
            "--" if "|F" in name else "-",
            label=name,
        )
    axes.set_xlabel("step")
    axes.set_ylabel("registered correlation, validation")
    axes.legend(fontsize=7)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
