"""`python -m invert`: frames or autocorrelations to albedo, report.png and result.json; of many captures, a table as well."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError, check_device
from correlograph.ranges import BLUR, SEED, SI, WORKERS
from correlograph.workers import check_scheduler, check_workers

METHOD_CHOICES = ("unet", "classical", "hio", "raar", "er", "altmin", "twf", "taf", "mtwf", "admm-tv")


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m invert", description="Reconstruct a hidden object's albedo.")
    p.add_argument("inputs", nargs="+",
                   help="frames of one capture, a folder of them, folders of captures, or autocorrelation pictures")
    p.add_argument("-o", "--output", required=True, help="folder for albedo, report.png and result.json")
    p.add_argument("--method", choices=METHOD_CHOICES, default="unet")
    p.add_argument("--quality", choices=("fast", "balanced", "best"), default="balanced")
    p.add_argument("--autocorrelation", action="store_true", help="inputs are 127 x 127 estimates, one result each")
    p.add_argument("--pixel-pitch-m", type=SI, help="pixel pitch on the wall; wanted for lengths in metres only")
    p.add_argument("--wavelength-m", type=SI)
    p.add_argument("--distance-m", type=SI, help="hidden object to wall")
    p.add_argument("--patch", default="auto",
                   help="patch size in pixels, auto (300 um a lag, or an eighth of the frame), or fit (by the object's width)")
    p.add_argument("--mean", choices=("auto", "pooled", "fixed", "published"), default="auto",
                   help="what of the frames' mean is subtracted: what they show, nothing but each frame's own, what they share "
                        "at every lag, or as the paper does, on patches side by side")
    p.add_argument("--dark", type=Path, help="dark frame to subtract")
    p.add_argument("--flat", type=Path, help="frame of even light to divide by")
    p.add_argument("--mask", type=Path, help="picture whose zero pixels are left out")
    p.add_argument("--blur-pixels", type=BLUR,
                   help="standard deviation of a known Gaussian blur, in pixels, 0 for none; looked for if not given")
    p.add_argument("--truth", type=Path, help="known albedo (.npy or picture, one pixel a lag) to compare with")
    p.add_argument("--weights", type=Path, help="another network, .safetensors, for --method unet")
    p.add_argument("--seed", type=SEED, default=0)
    p.add_argument("--workers", type=WORKERS, help="processes for many captures; as many as the machine has cores")
    p.add_argument("--scheduler", help="address of a running Dask scheduler instead")
    p.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Find the captures; invert one, or all of them on workers."""
    options = parser().parse_args(argv)
    _check(options)
    from correlograph.files.output import output_folder, sole_writer
    from invert.batch.captures import find_captures

    captures = find_captures(options.inputs, options.autocorrelation)
    if "" in captures:
        _invert_one(_request(options), captures[""], Path(options.output))
        return
    if options.scheduler is not None:
        check_scheduler(options.scheduler)
    from invert.batch.many_captures import invert_captures

    output = output_folder(options.output)
    with sole_writer(output):
        invert_captures(_request(options), captures, output, options.workers, options.scheduler)
    print(f"{len(captures)} captures: {output / 'table.md'}")


def _invert_one(request: Any, files: Sequence[Path], output: Path) -> None:
    from tqdm import tqdm

    from invert.batch.captures import invert_capture
    from invert.pipeline import steps

    with tqdm(total=steps(request.method, request.quality), desc=request.method, unit="it", disable=None, leave=False) as bar:
        summary = invert_capture(request, files, output, bar.update)
    for warning in summary["warnings"]:
        print(f"warning: {warning}", file=sys.stderr)
    print(f"{'object found' if summary['object_found'] else 'no object found'}: {output / 'report.png'}")


def _request(options: Any) -> Any:
    from correlograph.files.capture import CameraFacts
    from correlograph.files.corrections import Corrections
    from invert.batch.captures import Request

    dark, flat, mask, weights, truth = (path and path.resolve() for path in (options.dark, options.flat, options.mask,
                                                                             options.weights, options.truth))
    known = CameraFacts(options.wavelength_m, options.pixel_pitch_m, options.distance_m)
    return Request(options.autocorrelation, known, Corrections(dark, flat, mask), _patch(options.patch), options.mean,
                   options.blur_pixels, options.method, options.quality, weights, truth, options.seed, options.device)


def _check(options: Any) -> None:
    """Check options that argparse cannot."""
    _patch(options.patch)
    check_device(options.device)
    options.workers = check_workers(options.workers, options.scheduler)
    if options.weights is not None and options.method != "unet":
        raise InputError("--weights", "--method unet beside it", options.method, "leave it out")
    if options.autocorrelation and (options.patch != "auto" or options.dark or options.flat or options.mask
                                    or options.blur_pixels is not None):
        found = "--patch, --dark, --flat, --mask or --blur-pixels, which go with frames"
        raise InputError("--autocorrelation", "estimates as they are", found, "leave them out")


def _patch(text: str) -> Any:
    """Patch size in pixels, None for auto, or fit."""
    if text in ("auto", "fit"):
        return None if text == "auto" else text
    from invert.measure.estimate import PATCH

    try:
        size = int(text)
    except ValueError:
        raise InputError("--patch", "a number of pixels, auto or fit", text, "choose another") from None
    return PATCH.check("--patch", size)


if __name__ == "__main__":
    run_command(main)
