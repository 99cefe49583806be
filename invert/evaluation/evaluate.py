"""`python -m invert.evaluate -o DIR`: compare methods on test sets by tables, figures and JSON; resumable."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.command import ArgumentParser
from correlograph.errors import InputError
from correlograph.ranges import FRAMES, SEED, Range
from invert.choices import BALANCED, FAST, METHODS, QUALITIES, UNET
from invert.evaluation.cells import Cell, read_cell, write_cell
from radiometry.estimation.background import MEAN_MODELS

SETS = ("edges", "shapes", "unusual", "grey", "rendered", "rendered-edges", "measured")
CHARACTER_SETS = ("rendered", "measured 7", "measured letters")
"""Test sets of upright characters, in which the reconstructed character is identified."""


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m invert.evaluate", description="Compare methods on test sets.")
    p.add_argument("-o", "--output", required=True, help="folder for table.md, results.json and pictures")
    p.add_argument("--sets", nargs="+", choices=SETS, default=["shapes", "rendered"])
    p.add_argument(
        "--methods",
        nargs="+",
        default=["unet", "classical", "hio"],
        metavar="NAME[:QUALITY]",
        help="methods as python -m invert knows them, e.g. unet:fast classical:best hio",
    )
    p.add_argument(
        "--weights", nargs="*", default=[], metavar="NAME=FILE", help="weights of further networks, evaluated with quality fast"
    )
    p.add_argument("--images", type=Path, help="folder of photographs for the sets of edges and of grey pieces")
    p.add_argument("--measured", type=Path, help="folder of published autocorrelations for the measured set")
    p.add_argument("--levels", type=Range(1, 1000), help="number of noise levels or exposures of each set (default: all)")
    p.add_argument("--count", type=Range(1, 100_000), default=16, help="images per level (rendered: captures per letter)")
    p.add_argument("--frames", type=FRAMES, default=2, help="frames of a rendered capture")
    p.add_argument(
        "--mean-models",
        "--means",
        dest="mean_models",
        nargs="+",
        choices=MEAN_MODELS,
        default=["auto"],
        help="background models; each gives an estimate of every rendered capture",
    )
    p.add_argument("--seed", type=SEED, default=0)
    p.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Evaluate each method on each level of each set, then write the report."""
    options = parser().parse_args(argv)
    methods = _check(options)
    from tqdm import tqdm

    from correlograph.files.manifest import claim, digests_in
    from correlograph.files.output import output_folder, sole_writer
    from correlograph.progress import stage
    from invert.evaluation.report import write_report

    with stage("preparing the first level"):
        levels = _levels(options)
        levels = chain([next(levels)], levels)  # refuses unusable input before a folder is created
    output = output_folder(options.output)
    cells = output_folder(output / "cells")
    with sole_writer(output), sole_writer(cells):
        claim(output, ["table.md", "results.json", "pareto.png", *_figure_names(options)], overwrite=options.overwrite)
        claim(cells, digests_in(cells), overwrite=options.overwrite)
        results = [
            _cell(cells, level, name, settings, options)
            for level in tqdm(levels, unit="level", disable=None)
            for name, settings in methods.items()
        ]
        write_report(output, results)
    print(output / "table.md")


def _figure_names(options: Any) -> list[str]:
    from invert.evaluation.report import figure_name
    from invert.evaluation.sets import set_names

    return [figure_name(one) for name in options.sets for one in set_names(name, options.frames, options.mean_models)]


def _levels(options: Any) -> Iterator:
    from itertools import islice

    from invert.evaluation import sets

    for name in options.sets:
        levels = {
            "edges": lambda: sets.edges(options.images, options.count, options.seed),
            "grey": lambda: sets.grey(options.images, options.count, options.seed),
            "shapes": lambda: sets.shapes(options.count, options.seed),
            "unusual": lambda: sets.unusual(options.count, options.seed),
            "rendered": lambda: sets.render_letter_set(options.count, options.seed, options.frames, options.mean_models),
            "rendered-edges": lambda: sets.rendered_edges(
                options.images, options.count, options.seed, options.frames, options.mean_models
            ),
            "measured": lambda: sets.load_measured_set(options.measured),
        }[name]()
        each = len(options.mean_models) if name.startswith("rendered") else 1
        yield from islice(levels, options.levels and options.levels * each)


def _cell(cells: Path, level: Any, name: str, settings: dict[str, Any], options: Any) -> Cell:
    """Evaluate one method on one level; a finished cell of the same arguments is read from disk."""
    asked = {
        "set": level.test_set,
        "level": level.label,
        "seed": options.seed,
        "cases": [case.name for case in level.cases],
        **{key: str(value) for key, value in settings.items()},
        "method": name,
        "data": _digest(level, settings),
    }
    known = read_cell(cells, asked)
    if known is not None:
        return known
    found = [_score_case(level, case, settings, options) for case in level.cases]
    cell = Cell(
        asked,
        [row for row, _ in found],
        np.stack([albedo for _, albedo in found]),
        np.stack([case.truth for case in level.cases]),
    )
    write_cell(cells, cell)
    return cell


def _score_case(level: Any, case: Any, settings: dict[str, Any], options: Any) -> tuple[dict[str, Any], np.ndarray]:
    """Reconstruct one case as `python -m invert` does; return its scores and its albedo."""
    from invert.albedo.metrics import agreement, score
    from invert.evaluation.identification import identify
    from invert.likelihood.gamma import log_likelihood_leads
    from invert.pipeline import reconstruct

    begin = time.perf_counter()
    result = reconstruct(case.estimate, seed=options.seed, device=options.device, **settings)
    row: dict[str, Any] = {
        "seconds": time.perf_counter() - begin,
        "found": result.object_found,
        "confidence": result.confidence,
        **score(result.albedo, case.truth).as_dict(),
    }
    measurement = result.measurement
    row["agreement"] = agreement(result.albedo, measurement.values, measurement.noise.floor, measurement.noise.signal_ring)
    if case.others and result.object_found:
        row["nats_each"] = log_likelihood_leads(case.truth, result.albedo, case.others)
        row["nats"] = float(np.mean(row["nats_each"]))
    if level.test_set.split(",")[0] in CHARACTER_SETS:
        ranking = identify(result.albedo, mirrored=level.test_set.startswith("measured"))
        row["recognised"] = ranking[0][0] == case.name
    return row, result.albedo


def _digest(level: Any, settings: dict[str, Any]) -> str:
    """Return the SHA-256 of a level's estimates and truths, and of the network weights."""
    whole = hashlib.sha256()
    for case in level.cases:
        whole.update(case.estimate.values.tobytes() + case.truth.tobytes())
        for measurement in case.others:
            whole.update(measurement.values.tobytes())
    weights = settings.get("weights") or settings["method"].weights
    if weights is not None:
        whole.update(weights.read_bytes())
    return whole.hexdigest()


def _check(options: Any) -> dict[str, dict[str, Any]]:
    """Check the options; return the settings of each method by name."""
    if options.images is None and {"edges", "grey", "rendered-edges"} & set(options.sets):
        raise InputError(
            "--images", "a folder of photographs for the sets of edges and of grey pieces", "none", "add --images FOLDER"
        )
    if "measured" in options.sets and options.measured is None:
        raise InputError("--measured", "a folder of published autocorrelations", "none", "add --measured FOLDER")
    options.mean_models = list(dict.fromkeys(options.mean_models))
    methods: dict[str, dict[str, Any]] = {}
    for text in options.methods:
        name, _, quality = text.partition(":")
        if name not in METHODS or (quality or BALANCED.name) not in QUALITIES:
            raise InputError(
                "--methods", f"NAME[:QUALITY] of {', '.join(METHODS)} and {', '.join(QUALITIES)}", text, "correct the value"
            )
        methods[text] = {"method": METHODS[name], "quality": QUALITIES[quality] if quality else BALANCED}
    for text in options.weights:
        name, equals, file = text.partition("=")
        if not equals or not Path(file).is_file():
            raise InputError("--weights", "NAME=FILE, an existing file", text, "correct the value")
        if name in methods:
            raise InputError("--weights", "names of their own", f"{name} twice", "use another name")
        methods[name] = {"method": UNET, "quality": FAST, "weights": Path(file)}
    return methods
