"""`python -m invert`: reconstruct albedos from frames or autocorrelations; for many captures, with a table."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError, check_device
from correlograph.ranges import BLUR, LAG_COUNT, OBJECT_NUMBER, PATCH, RATE, SEED, SI, WAVELENGTH, WORKERS, Range
from correlograph.workers import check_scheduler, check_workers
from invert.choices import FIELD, METHODS, QUALITIES, UNET, retrieves_fields
from radiometry.estimation.background import MEAN_MODELS

if TYPE_CHECKING:
    from invert.batch.captures import Captures, Job


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m invert", description="Reconstruct the albedo of a hidden object.")
    p.add_argument(
        "inputs", nargs="+", help="frames of one capture, a folder of them, folders of captures, or autocorrelation images"
    )
    p.add_argument("-o", "--output", required=True, help="folder for albedo, report.png and result.json")
    p.add_argument("--method", choices=tuple(METHODS), default="unet")
    p.add_argument("--quality", choices=tuple(QUALITIES), default="balanced")
    p.add_argument("--autocorrelation", action="store_true", help="inputs are estimates of 127 x 127 lags, one result each")
    p.add_argument(
        "--pixel-pitch-m",
        type=SI,
        help="pixel pitch on the virtual detector in metres, for sizes in metres; default: that in the metadata of the file",
    )
    p.add_argument("--wavelength-m", type=WAVELENGTH, help="wavelength in metres, for example 532e-9")
    p.add_argument("--distance-m", type=SI, help="distance from the hidden object to the virtual detector in metres")
    p.add_argument(
        "--patch",
        default="auto",
        help="patch size in pixels; auto: from the lag pitch, or an eighth of the frame; fit: adapted to the width of the object",
    )
    p.add_argument("--lags", default="auto", help="largest lag on either side of zero, 32 to 255; auto: adapted to the object")
    p.add_argument("--pitch-m", default="auto", help="lag pitch in metres, for example 150e-6; auto: adapted to the object")
    p.add_argument(
        "--mean-model",
        "--mean",
        dest="mean_model",
        choices=MEAN_MODELS,
        default="auto",
        help="background model: auto detects it, pooled subtracts the mean of each frame, fixed subtracts what frames share, "
        "published follows Metzler et al. 2020",
    )
    p.add_argument("--dark", type=Path, help="dark frame, or a stack or folder of dark frames; their mean is subtracted")
    p.add_argument("--flat", type=Path, help="flat-field frame; frames are divided by it")
    p.add_argument("--mask", type=Path, help="image; its zero pixels are excluded")
    p.add_argument(
        "--blur-pixels",
        help="standard deviation, in pixels, of a Gaussian blur in the frames, which is corrected; 0: no blur; auto: estimate it; "
        "default: auto for unet, 0 for the other methods",
    )
    p.add_argument(
        "--object",
        type=OBJECT_NUMBER,
        default=1,
        help="which object to reconstruct where several move with the laser at rest, 1 for the brightest (1)",
    )
    p.add_argument("--truth", type=Path, help="known albedo (.npy or image) to compare with; one pixel per lag without a pitch")
    p.add_argument("--truth-pitch-m", type=SI, help="pixel pitch of the known albedo in metres; it is resampled to the lags")
    p.add_argument("--weights", type=Path, help="other network weights, .safetensors, for --method unet")
    p.add_argument(
        "--save-fields", action="store_true", help="also write the field of each frame (fields.npz), for --method field"
    )
    p.add_argument(
        "--video",
        action="store_true",
        help="reconstruct a film of a moving object from at least eight frames in order (film.gif, .png, .csv, .json, .npy)",
    )
    p.add_argument("--frames-per-s", type=RATE, help="frames per second, for the times of --video")
    p.add_argument("--seed", type=SEED, default=0)
    p.add_argument("--workers", type=WORKERS, help="processes for many captures; default: one per core")
    p.add_argument(
        "--scheduler", help="address of a running Dask scheduler for many captures, or for the frames of one above 1 GB"
    )
    p.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Find the captures among the inputs; reconstruct one, or all of them on workers."""
    options = parser().parse_args(argv)
    workers = _check(options)
    from correlograph.progress import stage

    with stage("loading"):
        from invert.batch.captures import find_captures

    job = _job(options)
    captures = find_captures(options.inputs, options.autocorrelation)
    if options.video:
        _invert_video(job, captures, options)
    elif "" in captures:
        _invert_one(job, captures[""], options)
    else:
        _invert_many(job, captures, options, workers)


def _invert_one(job: Job, files: Sequence[Path], options: Any) -> None:
    from tqdm import tqdm

    from invert.methods import reconstructor

    begin, output, overwrite = time.perf_counter(), Path(options.output), options.overwrite
    method, quality = job.request.method, job.request.quality
    steps = reconstructor(method, quality).steps
    with tqdm(total=steps, desc=f"{method}:{quality}", unit="step", disable=None, leave=False) as bar:
        shown = replace(job, request=replace(job.request, progress=bar.update, scheduler=options.scheduler))
        result, summary = shown.run(files, output, overwrite=overwrite)
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    for note in result.notes:
        print(f"note: {note}", file=sys.stderr)
    parts = ["object found" if result.object_found else "no object found", f"confidence {result.confidence:.2f}"]
    if "pearson" in summary:
        parts.append(f"correlation {summary['pearson']:.2f}")
    print(f"{', '.join(parts)}, {time.perf_counter() - begin:.1f} s: {output / 'report.png'}")


def _invert_video(job: Job, captures: Captures, options: Any) -> None:
    from correlograph.files.manifest import claim
    from correlograph.files.output import output_folder
    from invert.video.film import FILM_FILES
    from invert.video.video import film_of

    if "" not in captures:
        raise InputError("inputs", "frames of one capture for --video", f"{len(captures)} captures", "give them one by one")
    begin, folder = time.perf_counter(), output_folder(options.output)
    claim(folder, FILM_FILES, overwrite=options.overwrite)
    found = film_of(job.request, captures[""], None if options.frames_per_s is None else 1.0 / options.frames_per_s)
    found.save(folder)
    for note in found.notes:
        print(f"note: {note}", file=sys.stderr)
    print(f"{found!r}, {time.perf_counter() - begin:.1f} s: {folder / 'film.gif'}")


def _invert_many(job: Job, captures: Captures, options: Any, workers: int) -> None:
    from correlograph.files.output import output_folder, sole_writer
    from invert.batch.captures import skipped_folders
    from invert.batch.many_captures import invert_captures

    for folder in skipped_folders(options.inputs):
        print(f"warning: {folder} is left out, because it holds no frames", file=sys.stderr)
    output = output_folder(options.output)
    with sole_writer(output):
        invert_captures(job, captures, output, workers, options.scheduler, overwrite=options.overwrite)
    print(f"{len(captures)} captures, their confidence in {output / 'table.md'}")


def _job(options: Any) -> Job:
    from correlograph.files.capture import CameraMetadata
    from correlograph.files.corrections import Corrections
    from invert.batch.captures import Job
    from invert.request import Request

    named = (options.dark, options.flat, options.mask, options.weights, options.truth)
    dark, flat, mask, weights, truth = (path and path.resolve() for path in named)
    request = Request(
        autocorrelation=options.autocorrelation,
        camera=CameraMetadata(options.wavelength_m, options.pixel_pitch_m, options.distance_m),
        corrections=Corrections(dark, flat, mask),
        patch=_patch(options.patch),
        lags=_number("--lags", options.lags, LAG_COUNT),
        pitch_m=_number("--pitch-m", options.pitch_m, SI),
        mean_model=options.mean_model,
        object_number=options.object,
        blur_pixels=_blur(options.blur_pixels),
        method=METHODS[options.method],
        quality=QUALITIES[options.quality],
        weights=weights,
        seed=options.seed,
        device=options.device,
    )
    return Job(request, truth, options.truth_pitch_m, options.save_fields)


def _check(options: Any) -> int:
    """Check options that argparse cannot check; return the number of workers."""
    _patch(options.patch)
    _number("--lags", options.lags, LAG_COUNT)
    _number("--pitch-m", options.pitch_m, SI)
    _blur(options.blur_pixels)
    if not options.output.strip():
        raise InputError("-o", "the name of a folder", "an empty one", "choose another folder")
    check_device(options.device)
    workers = check_workers(options.workers, options.scheduler)
    if options.scheduler is not None:
        check_scheduler(options.scheduler)
    method = METHODS[options.method]
    if options.weights is not None and method.weights is None:
        expected = f"--method {UNET} or {FIELD}"
        raise InputError("--weights", expected, f"--method {method}", f"select --method {UNET} or remove --weights")
    if options.save_fields and not retrieves_fields(method, QUALITIES[options.quality]):
        expected, found = f"--method {FIELD}, or --quality best", f"--method {method}, --quality {options.quality}"
        raise InputError("--save-fields", expected, found, f"select --method {FIELD}")
    _check_video(options)
    given = [name for name in ("dark", "flat", "mask", "blur_pixels") if getattr(options, name) is not None]
    given += [name for name in ("patch", "lags", "pitch_m", "mean_model") if getattr(options, name) != "auto"]
    given += ["object"] if options.object > 1 else []
    if options.autocorrelation and given:
        found = ", ".join("--" + name.replace("_", "-") for name in given)
        raise InputError("--autocorrelation", "no option that applies to frames", found, "remove these options")
    return workers


def _check_video(options: Any) -> None:
    """Refuse options that a film does not have, and times without one."""
    if not options.video and options.frames_per_s is not None:
        raise InputError("--frames-per-s", "--video, whose times it sets", "no --video", "remove --frames-per-s")
    given = [name for name in ("autocorrelation", "truth", "save_fields", "scheduler") if getattr(options, name)]
    given += ["object"] if options.object > 1 else []
    if options.video and given:
        found = ", ".join("--" + name.replace("_", "-") for name in given)
        raise InputError("--video", "no option of single images", found, "remove it")


def _patch(text: str) -> Any:
    """Return the patch size in pixels, None for auto, or fit."""
    if text in ("auto", "fit"):
        return None if text == "auto" else text
    try:
        size = int(text)
    except ValueError:
        raise InputError("--patch", "a number of pixels, auto or fit", text, "use one of these") from None
    return PATCH.check("--patch", size)


def _number(name: str, text: str, values: Range) -> Any:
    """Return a number in a range, or None for auto."""
    if text == "auto":
        return None
    try:
        number = int(text) if isinstance(values.least, int) else float(text)
    except ValueError:
        raise InputError(name, f"{values} or auto", text, "use one of these") from None
    return values.check(name, number)


def _blur(text: str | None) -> Any:
    """Return the blur in pixels, auto, or None if the option is missing."""
    if text is None or text == "auto":
        return text
    try:
        pixels = float(text)
    except ValueError:
        raise InputError("--blur-pixels", "a number of pixels or auto", text, "use one of these") from None
    return BLUR.check("--blur-pixels", pixels)


if __name__ == "__main__":
    run_command(main)
