"""`python -m benchmarks.fields -o FOLDER --sets pages texts letters speed light bars random`: what fields add to the autocorrelation.

Frames are rendered. Correlations compare the albedo with the scene's on pixels of 30 um, unsmoothed and smoothed by Gaussians of 75, 150
and 300 um full width at half maximum. Pages are also read by `tesseract`. Figures and a table in JSON are written to the folder.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from scipy import ndimage

import correlograph as cg
from benchmarks.pages import PAGES, page
from benchmarks.random_captures import draw_scene
from correlograph.files.figures import save_figure
from data_gen.bars import SIDE_M, bar_contrast, bar_groups
from invert.albedo.metrics import register_subpixel
from invert.evaluation.text import character_error_rate, read_text
from invert.field.blending import enlarge_albedo
from invert.field.certificate import MIN_GAIN_SIGMA
from invert.field.retrieval import retrieve_fields
from radiometry.field_forecast import MIN_PHOTONS_PER_GRAIN
from radiometry.prediction import predict
from radiometry.ring_correlation import MIN_CORRELATION_WITH_TRUTH, half_period

WIDTHS_UM = (0, 75, 150, 300)
"""Full widths at half maximum of the smoothing, in um."""

FWHM_PER_SIGMA = 2.3548

EXPOSURES_S = (1 / 8, 1 / 16, 1 / 23, 1 / 32)

MAX_PAGE_FRAMES = 10

CORNER = 257
"""Side of the part of a frame that figures show, in pixels."""

RANDOM_CAPTURES = 30

RANDOM_PAGES = 6

WORDS = (
    *("above", "again", "beyond", "bright", "corner", "count", "distant", "early", "field", "glass", "hidden", "index"),
    *("journey", "kitchen", "laser", "mirror", "night", "orange", "photon", "quiet", "river", "shadow", "table", "under"),
    *("valley", "window", "xenon", "yellow", "zebra", "17", "365", "2048"),
)
"""Words of the random pages."""


def correlations(albedo: np.ndarray, truth: np.ndarray, pitches_m: tuple[float, float]) -> list[float]:
    """Return the correlations of registered images (rows, columns) for each smoothing."""
    found = []
    for width in WIDTHS_UM:
        sigma = [width * 1e-6 / FWHM_PER_SIGMA / pitch for pitch in pitches_m]
        images = [ndimage.gaussian_filter(one.astype(np.float64), sigma) if width else one for one in (albedo, truth)]
        found.append(round(register_subpixel(*images)[0], 4))
    return found


def resolved_um(albedo: np.ndarray, truth: np.ndarray, pitches_m: tuple[float, float]) -> int:
    """Return half of the period, in um, at which the ring correlation of an albedo (rows, columns) with the truth falls below 1/2."""
    return round(1e6 * half_period(register_subpixel(albedo, truth)[1], truth, pitches_m, MIN_CORRELATION_WITH_TRUTH))


def compare(
    scene: cg.Scene, capture: cg.Capture, quality: str = "balanced", *, oracle: bool = False
) -> tuple[dict[str, Any], list[np.ndarray]]:
    """Return the figures of one capture; and a corner of its first frame, coarse albedo, fine albedo and truth on the same pixels,
    registered.

    Args:
        oracle: whether to retrieve the fields also with the true albedo as prior.
    """
    begin = time.process_time()
    result = cg.reconstruct(capture, method="field", quality=quality)
    cpu_s = time.process_time() - begin
    fields, lags = result.fields, result.estimate.pitches_m
    cells = 1 if fields is None else fields.cells_per_lag
    pitches = (lags[0] / cells, lags[1] / cells)
    enlarged = enlarge_albedo(result.coarse_albedo, cells)
    truth = scene.geometry.hidden_object.sample(pitches, enlarged.shape).albedo.astype(np.float64)
    row: dict[str, Any] = {
        "frames": len(capture.frames),
        "confidence": round(result.confidence, 3),
        "coarse": correlations(enlarged, truth, pitches),
        "coarse_resolved_um": resolved_um(enlarged, truth, pitches),
        "cpu_s": round(cpu_s, 1),
        "wall_s": {name: round(seconds, 1) for name, seconds in result.seconds.items()},
        "accepted": fields is not None,
        "pitches_m": pitches,
    }
    if fields is not None:
        row |= {"fields": correlations(result.albedo, truth, pitches), **fields.as_dict(lags)}
        row["fields_resolved_um"] = resolved_um(result.albedo, truth, pitches)
        row["resolution_um"] = None if fields.resolution_m(lags) is None else round(1e6 * fields.resolution_m(lags))
    else:
        row["reason"] = next((note for note in result.notes if "coarse albedo stands" in note), "")
    if oracle and result.object_found:
        known = replace(result.reconstruction, albedo=result.truth_on_lags(cg.Truth.of(capture)))
        found = {"real": fields, "oracle": retrieve_fields(capture, result.estimate, known, 0)}
        if fields is None:
            found["real"] = retrieve_fields(capture, result.estimate, result.reconstruction, 0)
        row |= {f"sigma_{prior}_prior": round(one.certificate.gain_sigma, 1) for prior, one in found.items()}
    shown = [cg.aligned_pearson(one, truth.astype(np.float32))[1] for one in (enlarged, result.albedo)]
    return row, [capture.frames[0][:CORNER, :CORNER], *shown, truth]


def pages(folder: Path) -> Iterator[tuple[str, dict[str, Any], list[np.ndarray]]]:
    """Yield name, figures and images of each page of text."""
    for name, text, frames in PAGES:
        row, images = _read_page(folder, text, min(frames, MAX_PAGE_FRAMES), seed=5)
        yield name.split(",")[0] + f", {row['frames']} x 1 s", row, images


def texts(folder: Path) -> Iterator[tuple[str, dict[str, Any], list[np.ndarray]]]:
    """Yield the same of pages of random words, three to seven lines, ten frames of 1 s."""
    for number in range(RANDOM_PAGES):
        rng = np.random.default_rng(number)
        lines = int(rng.integers(3, 8))
        text = "\n".join(" ".join(rng.choice(WORDS, max(1, lines // 2 - 1), replace=False)) for _ in range(lines))
        yield f"page {number}, {lines} lines", *_read_page(folder, text, MAX_PAGE_FRAMES, seed=100 + number)


def _read_page(folder: Path, text: str, frames: int, seed: int) -> tuple[dict[str, Any], list[np.ndarray]]:
    """Return the figures and images of a page, with the character errors of coarse albedo, fields and truth."""
    Image.fromarray(page(text)).save(folder / "page.png")
    scene = cg.load("corner_letter", albedo=str((folder / "page.png").resolve()), exposure=1.0)
    row, images = compare(scene, cg.render(scene, frames=frames, seed=seed))
    if shutil.which("tesseract"):
        cells = row.get("cells_per_lag", 1)
        row["errors"] = [round(100.0 * character_error_rate(text, read_text(one, cells)), 1) for one in images[1:]]
    return row, images


def letters(folder: Path, seeds: Sequence[int] = (1, 2, 3)) -> Iterator[tuple[str, dict[str, Any], list[np.ndarray]]]:
    """Yield the same of six letters, two frames of 1/8 s."""
    for letter in "F7LR5t":
        for seed in seeds:
            scene = cg.load("corner_letter", albedo=f"{letter}.png")
            yield f"{letter}, 2 x 1/8 s, seed {seed}", *compare(scene, cg.render(scene, frames=2, seed=seed))


def speed(folder: Path) -> Iterator[tuple[str, dict[str, Any], list[np.ndarray]]]:
    """Yield the same of a page and letters with both qualities that differ in the fields."""
    Image.fromarray(page(PAGES[0][1])).save(folder / "page.png")
    captures = ((str((folder / "page.png").resolve()), 10, 1.0), ("R.png", 2, 1.0), ("t.png", 2, 0.125))
    for albedo, frames, exposure in captures:
        scene = cg.load("corner_letter", albedo=albedo, exposure=exposure)
        capture = cg.render(scene, frames=frames, seed=5)
        for quality in ("fast", "balanced"):
            row, images = compare(scene, capture, quality)
            row["fields_wall_s_per_frame"] = round(row["wall_s"]["fields"] / frames, 1)
            yield f"{Path(albedo).stem}, {frames} x {exposure:g} s, {quality}", row, images


def light(folder: Path) -> Iterator[tuple[str, dict[str, Any], list[np.ndarray]]]:
    """Yield the same of a letter and a page over exposures."""
    Image.fromarray(page(PAGES[0][1])).save(folder / "page.png")
    for name, albedo in (("F", "F.png"), ("three lines", str((folder / "page.png").resolve()))):
        for exposure in EXPOSURES_S:
            scene = cg.load("corner_letter", albedo=albedo, exposure=exposure)
            row, images = compare(scene, cg.render(scene, frames=2, seed=3), oracle=True)
            yield f"{name}, 2 x 1/{round(1 / exposure)} s", row | forecast(scene, 2), images


def forecast(scene: cg.Scene, frames: int) -> dict[str, Any]:
    """Return what the plan of a scene says of its fields."""
    found = predict(scene.geometry).forecast_fields(frames)
    return (
        {} if found is None else {"predicted_photons_per_grain": round(found.photons_per_grain, 2), "predicted": found.suffices}
    )


def bars(folder: Path) -> Iterator[tuple[str, dict[str, Any], list[np.ndarray]]]:
    """Yield the same of the bar target, with the contrast of each width of bars for coarse albedo and fields."""
    for frames, exposure in ((2, 0.125), (2, 1.0), (10, 1.0)):
        scene = cg.load("bar_target", exposure=exposure)
        row, images = compare(scene, cg.render(scene, frames=frames, seed=4))
        targets = [_on_target(one, row["pitches_m"]) for one in images[1:]]
        for group in bar_groups():
            contrasts = [round(bar_contrast(one, group), 3) for one in targets]
            direction = "upright" if group.is_upright else "level"
            row[f"contrast_{1e6 * group.width_m:.0f}_um_{direction}"] = contrasts
        yield f"{frames} x {exposure:g} s", row, images


def _on_target(albedo: np.ndarray, pitches_m: Sequence[float]) -> np.ndarray:
    """Interpolate an albedo, centred on the bar target, to pixels of 10 um over the target."""
    places = (np.arange(round(SIDE_M / 10e-6)) + 0.5) * 10e-6 - 0.5 * SIDE_M
    positions = [places / pitch + 0.5 * (side - 1) for pitch, side in zip(pitches_m, albedo.shape, strict=True)]
    return ndimage.map_coordinates(albedo, np.meshgrid(*positions, indexing="ij"), order=1).clip(0.0)


def random(folder: Path) -> Iterator[tuple[str, dict[str, Any], list[np.ndarray]]]:
    """Yield the same of random scenes, objects and cameras (`benchmarks.random_captures`); photographs are optional."""
    photographs = folder / "photographs"
    for number in range(RANDOM_CAPTURES):
        drawn, scene, capture = draw_scene(number, folder, photographs if photographs.is_dir() else None)
        row, images = compare(scene, capture)
        yield f"random {number}: {drawn['object']}", drawn | row | forecast(scene, len(capture.frames)), images


SETS = {"pages": pages, "texts": texts, "letters": letters, "speed": speed, "light": light, "bars": bars, "random": random}


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--sets", nargs="+", choices=tuple(SETS), default=list(SETS))
    options = parser.parse_args(argv)
    options.output.mkdir(parents=True, exist_ok=True)
    for name in options.sets:
        rows, shown = {}, []
        for title, row, images in SETS[name](options.output):
            rows[title] = row
            shown.append((title, images))
            print(
                f"| {title} | " + " | ".join(f"{key} {value}" for key, value in row.items() if key != "certificate"), flush=True
            )
        (options.output / f"{name}.json").write_text(json.dumps(rows, indent=2))
        save_figure(options.output / f"fields_{name}.png", draw(shown))
        save_figure(options.output / f"fields_{name}_last.png", draw(shown[-1:]))
        if name == "light":
            save_figure(options.output / "fields_boundary.png", draw_boundary(rows))


def draw(shown: Sequence[tuple[str, list[np.ndarray]]]) -> Figure:
    """Plot frame, reconstructions and truth of captures, one per row."""
    figure = Figure(figsize=(12.8, 3.35 * len(shown)), layout="constrained")
    kinds = ("corner of a frame", "from the autocorrelation", "from fields", "truth")
    for axes, (title, images) in zip(figure.subplots(len(shown), 4, squeeze=False), shown, strict=True):
        for panel, image, kind in zip(axes, images, kinds, strict=True):
            panel.imshow(image, cmap="gray", vmax=np.quantile(image, 0.998))
            panel.set_title(f"{title}: {kind}" if len(shown) > 1 else kind, fontsize=9)
            panel.set_axis_off()
    return figure


def draw_boundary(rows: dict[str, dict[str, Any]]) -> Figure:
    """Plot by how many standard deviations fields predict held-out pixels against the predicted photons per grain."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    names = sorted({title.split(",")[0] for title in rows})
    for prior, marker in (("real", "o"), ("oracle", "x")):
        for number, name in enumerate(names):
            found = [row for title, row in rows.items() if title.split(",")[0] == name and f"sigma_{prior}_prior" in row]
            light, gain = ([row[key] for row in found] for key in ("predicted_photons_per_grain", f"sigma_{prior}_prior"))
            axes.plot(light, gain, marker, color=f"C{number}", label=f"{name}, {prior} prior")
    axes.axhline(MIN_GAIN_SIGMA, color="black", linewidth=0.8, label="accepted above")
    axes.axvline(MIN_PHOTONS_PER_GRAIN, color="black", linestyle="--", linewidth=0.8, label="predicted boundary")
    axes.set(
        xscale="log",
        xlabel="predicted photons per grain of the bounding box",
        ylabel="gain on held-out pixels (standard deviations)",
    )
    axes.legend(fontsize=8)
    return figure


if __name__ == "__main__":
    main()
