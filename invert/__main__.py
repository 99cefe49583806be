"""`python -m invert`: frames or autocorrelations to albedo, report.png and result.json."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from radiometry.errors import ArgumentParser, InputError, check_device, run_command

METHOD_CHOICES = ("unet", "classical", "hio", "raar", "er", "altmin", "twf", "taf", "mtwf", "admm-tv")


def parser() -> ArgumentParser:
    p = ArgumentParser(prog="python -m invert", description="Reconstruct a hidden object's albedo.")
    p.add_argument("inputs", nargs="+", help="frames of one capture, a folder of them, or autocorrelation pictures")
    p.add_argument("-o", "--output", required=True, help="folder for albedo, report.png and result.json")
    p.add_argument("--method", choices=METHOD_CHOICES, default="unet")
    p.add_argument("--quality", choices=("fast", "balanced", "best"), default="balanced")
    p.add_argument("--autocorrelation", action="store_true", help="inputs are 127 x 127 estimates, one result each")
    p.add_argument("--pixel-pitch-m", type=float, help="pixel pitch on the wall; wanted for lengths in metres only")
    p.add_argument("--wavelength-m", type=float)
    p.add_argument("--distance-m", type=float, help="hidden object to wall")
    p.add_argument("--patch", default="auto", help="patch size in pixels, or auto (300 um a lag, or an eighth of the frame)")
    p.add_argument("--mean", choices=("auto", "pooled", "fixed", "published"), default="auto",
                   help="what of the frames' mean is subtracted: what they show, nothing but each frame's own, what they share "
                        "at every lag, or as the paper does, on patches side by side")
    p.add_argument("--dark", type=Path, help="dark frame to subtract")
    p.add_argument("--flat", type=Path, help="frame of even light to divide by")
    p.add_argument("--mask", type=Path, help="picture whose zero pixels are left out")
    p.add_argument("--blur-pixels", type=float, help="standard deviation of a known Gaussian blur, in pixels")
    p.add_argument("--truth", type=Path, help="known albedo (.npy or picture, one pixel a lag) to compare with")
    p.add_argument("--weights", type=Path, help="another network, .safetensors, for --method unet")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Read, estimate, then retrieve and report each estimate."""
    options = parser().parse_args(argv)
    patch = _check(options)
    from invert.capture import read_capture
    from invert.estimate import estimate_from_frames, published_estimate
    from invert.result import check_truth_pitch, read_truth
    from radiometry.files.capture import CameraFacts
    from radiometry.files.corrections import Corrections
    from radiometry.files.output import output_folder, sole_writer

    begin = time.perf_counter()
    truth = read_truth(options.truth) if options.truth else None
    if options.autocorrelation:
        estimates = [published_estimate(Path(item)) for item in options.inputs]
        read_s = (time.perf_counter() - begin) / len(estimates)
    else:
        known = CameraFacts(options.wavelength_m, options.pixel_pitch_m, options.distance_m)
        corrections = Corrections(options.dark, options.flat, options.mask)
        capture = corrections.of(read_capture(options.inputs, known))
        read_s = time.perf_counter() - begin
        estimates = [estimate_from_frames(capture, patch, options.device, options.mean, options.blur_pixels)]
        if options.truth:
            check_truth_pitch(options.truth, estimates[0].pitches_m)

    output = output_folder(options.output)
    for estimate in estimates:
        folder = output if len(estimates) == 1 else output_folder(output / Path(estimate.name).stem)
        with sole_writer(folder):
            _invert(estimate, truth, read_s, folder, options)


def _invert(estimate, truth, read_s: float, folder: Path, options) -> None:
    """Read the noise, retrieve the albedo, write the result."""
    from tqdm import tqdm

    from invert.inversion import retrieved, steps

    with tqdm(total=steps(options.method, options.quality), desc=options.method, unit="it", disable=None, leave=False) as bar:
        result = retrieved(estimate, method=options.method, quality=options.quality, weights=options.weights,
                           seed=options.seed, device=options.device, read_s=read_s, progress=bar.update)
    summary = result.save(folder, truth)
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(f"{'object found' if summary['object_found'] else 'no object found'}: {folder / 'report.png'}")


def _check(options) -> int | None:
    """Check options that argparse cannot; returns the patch size, None for auto."""
    if not 0 <= options.seed < 2**63:
        raise InputError("--seed", "a whole number, zero or more", options.seed, "choose another")
    names = [Path(item).stem for item in options.inputs]
    if options.autocorrelation and len(set(names)) != len(names):
        raise InputError("inputs", "autocorrelations of different names", "one name twice",
                         "rename one; results go to folders of these names")
    check_device(options.device)
    if options.weights is not None and options.method != "unet":
        raise InputError("--weights", "--method unet beside it", options.method, "leave it out")
    if options.autocorrelation and (options.patch != "auto" or options.dark or options.flat or options.mask
                                    or options.blur_pixels is not None):
        found = "--patch, --dark, --flat, --mask or --blur-pixels, which go with frames"
        raise InputError("--autocorrelation", "estimates as they are", found, "leave them out")
    if options.patch == "auto":
        return None
    try:
        return int(options.patch)
    except ValueError:
        raise InputError("--patch", "a number of pixels or auto", options.patch, "choose another") from None


if __name__ == "__main__":
    run_command(main)
