"""`python -m benchmarks.false_alarms [--count 400]`: count false warnings and check the confidence on clean frames of random
objects, cameras and exposures.

Objects: letters, characters, edges and grey shapes. Cameras: 512 to 2056 pixels along a side, read noise 0 to 3 electrons, no ADC or one
of 8, 12 or 16 bits, several gains. Exposures: 1/512 to 1 s. Captures of 1, 2 or 10 frames. A warning is a false alarm unless it is true:
that the object may be wider than the lags, if r*r of the truth reaches as far as the warning needs; that the reconstruction leaves much
unexplained, if its correlation with the truth is below 0.5. The number of both is printed, and for the objects found, the mean difference
of confidence and correlation with the truth; `alarms.json` holds all captures.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

import correlograph as cg
from data_gen.edges import edge_targets, find_photographs, read_luminance
from data_gen.letters import letter
from data_gen.shapes import filled_shape, glyph
from invert.assess.hypotheses import Hypothesis
from invert.evaluation.sets import LETTERS, UNSEEN_CHARACTERS
from invert.measure.patch_fit import is_wider_than_lags
from invert.measure.spectrum import read_measurement
from radiometry.noise.model import autocorrelate_windowed
from radiometry.prediction import patches_of
from sim.rendering import render_geometry
from sim.scene import load

SIDE = 64
MIN_CORRELATION = 0.5
"""Correlation with the truth below which a reconstruction explains little of it."""


def draw_albedo(photographs: Path, rng: np.random.Generator) -> tuple[str, np.ndarray]:
    """Return the family and the albedo (64, 64) of an object."""
    kind = str(rng.choice(["letter", "character", "edges", "grey"]))
    if kind == "letter":
        drawn = letter(str(rng.choice(LETTERS)))
        return kind, np.pad(drawn.reshape(32, 8, 32, 8).mean((1, 3)), SIDE // 4) / 255.0
    if kind == "character":
        return kind, glyph(str(rng.choice(list(UNSEEN_CHARACTERS))), rng) / 255.0
    files = find_photographs(photographs)
    photograph = read_luminance(files.folder / str(rng.choice(files.names)))
    if kind == "edges":
        found = edge_targets(photograph, 1, rng)
        return draw_albedo(photographs, rng) if found is None else (kind, found[0] / 255.0)
    top, left = (rng.integers(size - SIDE) for size in photograph.shape)
    seen = photograph[top : top + SIDE, left : left + SIDE].astype(np.float64) * (filled_shape(rng) > 0)
    return kind, seen / max(seen.max(), 1.0)


def draw_capture(photographs: Path, number: int) -> tuple[dict[str, Any], cg.Capture, cg.Truth]:
    """Return the description of a random capture, the capture and the truth."""
    rng = np.random.default_rng([number, 7])
    kind, albedo = draw_albedo(photographs, rng)
    geometry = load("corner_letter").geometry
    bits = int(rng.choice([0, 8, 12, 16]))
    drawn = {
        "object": kind,
        "shape": [int(rng.integers(512, 2057)), int(rng.integers(512, 2057))],
        "frames": int(rng.choice([1, 2, 10])),
        "exposure_s": float(2.0 ** rng.uniform(-9.0, 0.0)),
        "read_noise": float(rng.choice([0.0, rng.uniform(0.0, 3.0)])),
        "bits": bits,
        "gain": float(rng.uniform(0.1, 2.0)) if bits else 0.0,
    }
    camera = {name: drawn[name] for name in ("exposure_s", "read_noise", "bits", "gain")}
    pitches_m = patches_of(geometry)[1]
    geometry = geometry.with_object(albedo.astype(np.float32), pitches_m)
    geometry = geometry.with_camera(frame_shape=tuple(drawn["shape"])).with_electronics(**camera)
    return drawn, render_geometry(geometry, drawn["frames"], number), cg.Truth(albedo, pitches_m)


def is_true(warning: str, truth: cg.Truth, correlation: float) -> bool:
    """Return whether a warning is right although nothing is wrong with the frames."""
    if "unexplained" in warning:
        return correlation < MIN_CORRELATION
    if "wider than the lags" not in warning:
        return False
    albedo = torch.from_numpy(truth.albedo.astype(np.float32))
    return is_wider_than_lags(read_measurement(autocorrelate_windowed(albedo / albedo.max()).numpy()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--first", type=int, default=0, help="number of the first capture")
    parser.add_argument("--photographs", type=Path, default=Path("shared/data/bsds500/test"))
    parser.add_argument("--quality", default="fast")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/false_alarms"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    rows, kinds = [], Counter[str]()
    for number in tqdm(range(options.first, options.first + options.count), unit="capture", disable=None):
        drawn, capture, truth = draw_capture(options.photographs, number)
        result = cg.reconstruct(capture, quality=options.quality)
        correlation = result.compare(truth).pearson if result.object_found else 0.0
        row = {"number": number} | drawn | {"lags": result.estimate.lag_grid.lags, "found": result.object_found}
        row |= {"confidence": round(float(result.confidence), 3), "correlation": round(float(correlation), 3)}
        test = result.speckle_test
        row["third_moment"] = None if test is None else [test.third_moment_ratio, test.error]
        row["hypotheses"] = {one.value: probability for one, probability in result.hypotheses.items()}
        false = [one for one in result.warnings if not is_true(one, truth, correlation)]
        rows.append(row | {"warnings": list(result.warnings), "false": false})
        kinds.update("".join(c for c in warning if not c.isdigit())[:50] for warning in result.warnings)
        if result.warnings:
            tqdm.write(json.dumps(rows[-1]))
        (options.output / "alarms.json").write_text(json.dumps(rows, indent=1))
    warned, alarms = (sum(bool(row[which]) for row in rows) for which in ("warnings", "false"))
    apart = np.array([row["confidence"] - row["correlation"] for row in rows if row["found"]])
    print(
        f"confidence - correlation: mean {apart.mean():+.3f}, mean of moduli {np.abs(apart).mean():.3f}, largest {apart.max():+.2f}"
    )
    print(
        f"{alarms} of {len(rows)} captures with a false warning, {warned} with any; {sum(row['found'] for row in rows)} objects found"
    )
    for is_found in (True, False):
        if told := [row["hypotheses"] for row in rows if row["found"] == is_found]:
            mean = ", ".join(f"{one.value} {np.mean([row[one.value] for row in told]):.3f}" for one in Hypothesis)
            print(f"mean probabilities where {'an object' if is_found else 'none'} is found: {mean}")
    for kind, count in kinds.most_common():
        print(f"{count:4d}  {kind}")


if __name__ == "__main__":
    main()
