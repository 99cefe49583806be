"""`python -m data_gen`: generate targets and their measurements as a Zarr dataset, in parallel; runs can be interrupted."""

from __future__ import annotations

import time
from collections.abc import Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError
from correlograph.lags import LAGS
from correlograph.ranges import LAG_COUNT, SEED, SI, WORKERS, Range
from correlograph.workers import check_scheduler, check_workers

PACKAGES = ("correlograph", "matplotlib", "mitsuba", "numpy", "pillow", "scikit-image", "scipy", "torch", "zarr")
"""Packages whose versions affect the bytes of a dataset."""


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m data_gen", description="Make a dataset of hidden objects and their autocorrelations.")
    p.add_argument("output", help="address of the Zarr store: a path, or any address fsspec knows")
    p.add_argument("--images", type=Path, help="folder of photographs whose Canny edges are targets")
    p.add_argument(
        "--source",
        choices=("edges", "glyphs", "strokes", "shapes", "pages", "mixed", "all"),
        help="kind of targets; with --images, edges of the photographs by default; mixed and all combine several kinds",
    )
    p.add_argument("--lags", type=LAG_COUNT, default=LAGS, help="largest lag; targets have one pixel more along each side (63)")
    p.add_argument("--count", type=Range(1, 10**9), required=True, help="number of targets")
    p.add_argument("--seed", type=SEED, default=0, help="seed of all random numbers (0)")
    p.add_argument(
        "--measurement",
        choices=("none", "noise-model", "render"),
        default="none",
        help="none: targets only; noise-model: also estimates from the noise model; render: also estimates from rendered frames",
    )
    p.add_argument("--scene", help="scene file or name of a shipped scene; targets replace its hidden object")
    bounds = ("LOW", "HIGH")
    p.add_argument("--floor-over-peak", type=SI, nargs=2, metavar=bounds, help="floors over peak of the noise model (0.01 0.7)")
    p.add_argument("--dof", type=SI, nargs=2, metavar=bounds, help="degrees of freedom K of the noise model (4 1000)")
    p.add_argument("--workers", type=WORKERS, help="processes on this machine; as many as it has cores")
    p.add_argument("--scheduler", help="address of a running Dask scheduler instead")
    p.add_argument("--dry-run", action="store_true", help="say count, bytes and predicted time, and write nothing")
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Find the photographs, open the store, make the missing shards."""
    options = parser().parse_args(argv)
    _check(options)
    from correlograph.files.output import sole_writer
    from correlograph.files.store import begin, missing_parts, store_address
    from data_gen.schedule import make_shards, predicted_seconds
    from data_gen.store import dataset_schema, pair_bytes

    address = store_address(options.output)
    recipe, manifest = _recipe(options)
    if options.dry_run:
        pairs = recipe.measurement != "none"
        size = recipe.count * (pair_bytes(options.lags) if pairs else 300)
        print(
            f"{recipe.count} {'pairs' if pairs else 'targets'}, about {size / 1e9:.3g} GB, "
            f"about {predicted_seconds(recipe, options.workers):.0f} s with {options.workers} workers"
        )
        return
    _try_out(recipe, options.scheduler)
    with sole_writer(address, "dataset"):
        schema = dataset_schema(recipe.measurement, options.lags)
        group = begin(address, schema, manifest, recipe.count)
        missing, started = missing_parts(group, address, schema), time.perf_counter()
        made = make_shards(address, recipe, missing, options.workers, options.scheduler)
        seconds = time.perf_counter() - started
    print(f"{options.output}: {recipe.count} samples, {made} made now" + (f" ({made / seconds:.0f} a second)" if made else ""))


def _check(options: Any) -> None:
    if options.images is None and options.source is None:
        raise InputError("targets", "--images FOLDER or --source NAME", "neither", "add one")
    if options.images is not None and options.source not in (None, "edges", "mixed", "all"):
        raise InputError(
            "--source", "edges, mixed or all together with --images", f"--source {options.source}", "remove --images"
        )
    if options.measurement == "render" and options.scene is None:
        raise InputError("--scene", "a scene file for --measurement render", "none", "add --scene SCENE.xml")
    if options.measurement == "none" and options.scene is not None:
        raise InputError(
            "--scene", "--measurement render or noise-model", "--measurement none", "select one of these or remove --scene"
        )
    if (options.measurement != "noise-model" or options.scene) and (options.floor_over_peak or options.dof):
        raise InputError(
            "--floor-over-peak, --dof",
            "the noise model without a scene",
            f"--measurement {options.measurement}{' --scene' if options.scene else ''}",
            "remove them",
        )
    for name, bounds in (("--floor-over-peak", options.floor_over_peak), ("--dof", options.dof)):
        if bounds and bounds[0] > bounds[1]:
            raise InputError(name, "LOW up to HIGH", bounds, "exchange them")
    options.workers = check_workers(options.workers, options.scheduler)


def _try_out(recipe: Any, scheduler: str | None) -> None:
    """Refuse unusable input before a store is created: a dark scene, photographs without targets, a Dask scheduler that does
    not answer.
    """
    from data_gen.targets import draw_block
    from data_gen.work import measure

    if scheduler is not None:
        check_scheduler(scheduler)
    targets, _ = draw_block(recipe.source, recipe.seed, 0)
    if recipe.measurement != "none":
        measure(recipe, 0, targets[:1])


def _recipe(options: Any) -> tuple[Any, dict[str, Any]]:
    """Return the recipe of a dataset, and its manifest."""
    from data_gen.edges import find_photographs
    from data_gen.targets import target_source
    from data_gen.work import Recipe

    photographs = find_photographs(options.images) if options.images else None
    if photographs and photographs.skipped:
        listed = "; ".join(f"{name}: {reason}" for name, reason in photographs.skipped[:20])
        print(f"{len(photographs.skipped)} files skipped: {listed}{' ...' if len(photographs.skipped) > 20 else ''}")
    name = options.source or "edges"
    source = target_source(name, photographs, options.lags + 1)
    scene = _find_scene(options.scene) if options.scene else None
    recipe = Recipe(
        source,
        options.count,
        options.seed,
        options.measurement,
        scene,
        tuple(options.floor_over_peak or (0.01, 0.7)),
        tuple(options.dof or (4.0, 1000.0)),
    )
    level: dict[str, Any] = {"scene_sha256": _scene_sha256(scene)} if scene else {}
    if options.measurement == "noise-model" and not scene:
        level = {"floor_over_peak": list(recipe.floor_over_peak), "dof": list(recipe.dof)}
    manifest = {
        "arguments": {
            "source": name,
            "kinds": list(source.kinds),
            "count": options.count,
            "seed": options.seed,
            "measurement": options.measurement,
            **({} if options.lags == LAGS else {"lags": options.lags}),
            **level,
        },
        "photographs": [list(pair) for pair in zip(photographs.names, photographs.hashes, strict=True)] if photographs else [],
        "skipped": [list(pair) for pair in photographs.skipped] if photographs else [],
        "versions": {package: version(package) for package in PACKAGES if package != "mitsuba" or find_spec(package)},
    }
    return recipe, manifest


def _find_scene(name: str) -> str:
    from sim.scene_file import find_scene

    return str(find_scene(name))


def _scene_sha256(scene: str) -> str:
    from sim.scene_file import load_scene

    return load_scene(scene, {})[1]


if __name__ == "__main__":
    run_command(main)
