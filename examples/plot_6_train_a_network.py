"""
Training data and a small training
==================================

Targets, noise from the noise model, and a few steps of a narrow denoiser. A useful one takes 6000 steps and one or two hours.
"""

import json
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from data_gen.__main__ import main as make_dataset
from data_gen.dataset import load_targets
from invert.training.train import main as train

folder = Path(tempfile.mkdtemp())

if __name__ == "__main__":  # several processes generate datasets
    make_dataset(
        [str(folder / "targets.zarr"), "--source", "shapes", "--count", "512", "--measurement", "none", "--workers", "1"]
    )
    targets, held_out = load_targets(str(folder / "targets.zarr"))
    figure, axes = plt.subplots(1, 6, figsize=(9, 1.7), layout="constrained")
    for panel, target in zip(axes, targets, strict=False):
        panel.imshow(target, cmap="gray")
        panel.axis("off")

    # %%
    # The learning curve falls from the first steps.
    train(
        [
            str(folder / "targets.zarr"),
            "-o",
            str(folder / "small.safetensors"),
            "--width",
            "8",
            "--steps",
            "40",
            "--batch",
            "8",
            "--checkpoint-every",
            "10",
        ]
    )
    curve = json.loads((folder / "small.json").read_text())["curve"]
    plt.figure(figsize=(5, 3), layout="constrained")
    plt.plot([point["step"] for point in curve], [point["validation"][1] for point in curve], "o-")
    plt.xlabel("step")
    plt.ylabel("share of the noise left")
