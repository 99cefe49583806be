"""`python -m benchmarks.unknown_blur`: random objects in frames of random sharpness: blurs that are found, and what finding them is worth.

Characters, strokes, filled shapes and grey clouds, in one to four frames of 700 to 1200 pixels a side, with 0.2 to 30 photoelectrons per
pixel. One capture in two is blurred before photons are counted, by defocus or by motion. In two of three, ambient light or an unknown
offset of the camera lowers the contrast as well. Frames are made by `benchmarks.nuisances.speckle`, which shares nothing with `sim`. Each
capture is reconstructed with the blur that the search finds, without any, and with the true defocus.
"""

from __future__ import annotations

import argparse
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, uniform_filter1d

import invert
from benchmarks.nuisances import PATCH, is_confident_and_wrong, speckle
from benchmarks.tracking_pairs import draw_object
from invert.albedo.metrics import aligned_pearson

SIZES = (0.0, 0.1, 1.5, 3.0, 5.0)
"""Limits of the groups of blurs, in pixels."""


def draw_cloud(rng: np.random.Generator) -> np.ndarray:
    """Return a grey albedo (64, 64) with soft edges."""
    place = np.arange(64) - 31.5
    drawn = gaussian_filter(rng.standard_normal((64, 64)), rng.uniform(2.0, 4.0))
    envelope = np.exp(-(place[:, None] ** 2 + place**2) / (2.0 * rng.uniform(8.0, 14.0) ** 2))
    return (drawn / drawn.std() + 0.5).clip(0.0) * envelope


def draw(number: int) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Return the frames of random capture `number`, its albedo and its description."""
    rng = np.random.default_rng([number, 7802])
    albedo = np.asarray(draw_cloud(rng) if rng.random() < 0.25 else draw_object(rng), np.float64)
    shape = int(rng.integers(700, 1200)), int(rng.integers(700, 1200))
    level, count = float(10.0 ** rng.uniform(-0.7, 1.5)), int(rng.choice([1, 2, 4]))
    kind, light = str(rng.choice(["sharp", "sharp", "defocus", "motion"])), str(rng.choice(["none", "ambient", "offset"]))
    size, axis = float(rng.uniform(0.5, 5.0)) if kind != "sharp" else 0.0, int(rng.integers(2))
    frames = np.stack([speckle(albedo, rng, shape=shape) for _ in range(count)])
    if kind == "defocus":
        frames = gaussian_filter(frames, (0.0, size, size))
    if kind == "motion":
        width = max(2, round(size * 12.0**0.5))
        frames, size = uniform_filter1d(frames, width, axis=1 + axis), width / 12.0**0.5
    frames = rng.poisson(level * (frames.clip(0.0) + 0.5 * (light == "ambient"))) + 20.0 * level * (light == "offset")
    described = {"number": number, "blur": kind, "pixels": size, "axis": axis, "light": light, "level": level, "frames": count}
    return frames.astype(np.float32), albedo, described


def judge(number: int, quality: str) -> dict[str, Any]:
    """Return what is found in random capture `number`."""
    frames, albedo, row = draw(number)

    def run(**blur: float) -> tuple[invert.Result, float]:
        result = invert.reconstruct(frames, patch=PATCH, quality=quality, seed=0, **blur)
        return result, aligned_pearson(result.albedo, albedo)[0] if result.object_found else 0.0

    result, pearson = run()
    assert result.estimate.record is not None
    row |= {"found": result.estimate.record.blur_found_pixels, "confidence": result.confidence, "correlation": pearson}
    row["without"] = run(blur_pixels=0.0)[1]
    if row["blur"] == "defocus":
        row["known"] = run(blur_pixels=row["pixels"])[1]
    return row


def summary(rows: list[dict[str, Any]]) -> str:
    """Return a table of the rows, by light and size of the blur."""
    lines = [
        "| contrast lowered by | blur, pixels | captures | found | correlation | without search | confidence | confident and wrong |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for title, lights in (("blur alone", ("none",)), ("other light, too", ("ambient", "offset"))):
        for low, high in pairwise(SIZES):
            some = [one for one in rows if one["light"] in lights and low <= one["pixels"] < high]
            if not some:
                continue
            found = sum(one["found"] is not None for one in some)
            means = [np.mean([one[name] for one in some]) for name in ("correlation", "without", "confidence")]
            wrong = sum(is_confident_and_wrong(one["confidence"], one["correlation"]) for one in some)
            shown = "none" if high <= SIZES[1] else f"{max(low, 0.5):g} to {high:g}"
            values = [title, shown, str(len(some)), str(found), *(f"{mean:.2f}" for mean in means), str(wrong)]
            lines.append(f"| {' | '.join(values)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.unknown_blur", description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="number of the first capture (default: 0)")
    parser.add_argument("--count", type=int, default=60, help="number of captures (default: 60)")
    parser.add_argument("--quality", default="fast", help="quality of the reconstructions (default: fast)")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/unknown_blur.json"), help="file for the rows")
    options = parser.parse_args()
    rows = []
    options.output.parent.mkdir(parents=True, exist_ok=True)
    for number in range(options.first, options.first + options.count):
        rows.append(judge(number, options.quality))
        print(json.dumps(rows[-1]), flush=True)
    options.output.write_text(json.dumps(rows, indent=1))
    print(summary(rows))


if __name__ == "__main__":
    main()
