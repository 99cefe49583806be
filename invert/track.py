"""`python -m invert.track`: path of a moving object (laser at rest), or its rotation and distance (`--rotation`)."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from correlograph.command import ArgumentParser, run_command
from correlograph.errors import InputError
from correlograph.ranges import RATE, SI, WAVELENGTH, Range


def parser() -> ArgumentParser:
    p = ArgumentParser(
        prog="python -m invert.track",
        description="Track a hidden object by its speckle, with the laser at rest; or its rotation and distance.",
    )
    p.add_argument("inputs", nargs="+", help="frames in order: files, stacks, or a folder of them")
    p.add_argument(
        "-o", "--output", required=True, help="folder for track.csv, .json and .png, or rotation.csv, .json and .png"
    )
    p.add_argument(
        "--rotation",
        action="store_true",
        help="find rotation about the line of sight and change of distance instead (rotation.csv, .json, .png); the laser may move",
    )
    p.add_argument(
        "--source-distance-m", type=SI, help="distance from the laser spot to the object, for displacements in metres"
    )
    p.add_argument(
        "--source-angle-deg",
        nargs=2,
        type=float,
        metavar=("ROWS", "COLUMNS"),
        default=(0.0, 0.0),
        help="angles between the light from the laser spot and the line of sight (0 0)",
    )
    p.add_argument("--frames-per-s", type=RATE, help="frames per second, for velocities")
    p.add_argument("--binning", type=Range(1, 64), default=1, help="pixels that are added along each axis first (1)")
    p.add_argument("--dark", type=Path, help="frames without light, subtracted from all others")
    p.add_argument("--flat", type=Path, help="flat-field frame; frames are divided by it")
    p.add_argument("--pixel-pitch-m", type=SI, help="pixel pitch on the virtual detector in metres")
    p.add_argument("--wavelength-m", type=WAVELENGTH, help="wavelength in metres")
    p.add_argument("--distance-m", type=SI, help="distance from the hidden object to the virtual detector in metres")
    p.add_overwrite()
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """Read the frames, find the path, write it."""
    options = parser().parse_args(argv)
    from correlograph.files.capture import CameraMetadata
    from correlograph.files.captured_frames import describe_files, read_capture
    from correlograph.files.corrections import Corrections
    from correlograph.files.manifest import claim
    from correlograph.files.output import output_folder
    from invert.tracking.rotation import ROTATION_FILES, Rotation, track_rotation
    from invert.tracking.track import TRACK_FILES, Track
    from invert.tracking.tracker import track

    angle = tuple(options.source_angle_deg)
    of_paths = {
        "--binning": options.binning != 1,
        "--source-distance-m": options.source_distance_m is not None,
        "--source-angle-deg": any(angle),
    }
    if options.rotation and any(of_paths.values()):
        raise InputError("--rotation", "no option of paths", ", ".join(name for name in of_paths if of_paths[name]), "omit it")
    claim(output_folder(options.output), ROTATION_FILES if options.rotation else TRACK_FILES, overwrite=options.overwrite)
    known = CameraMetadata(options.wavelength_m, options.pixel_pitch_m, options.distance_m)
    corrections = Corrections(options.dark, options.flat)
    corrections.check()
    capture = corrections.apply(read_capture([Path(one) for one in options.inputs], known))
    interval_s = None if options.frames_per_s is None else 1.0 / options.frames_per_s
    if options.rotation:
        found: Rotation | Track = track_rotation(capture, interval_s=interval_s)
        warnings = list(found.warnings)
    else:
        found = track(
            capture,
            source_distance_m=options.source_distance_m,
            source_angle_deg=angle,
            interval_s=interval_s,
            binning=options.binning,
        )
        warnings = [warning for one in (found, *found.others) for warning in one.warnings]
    for note in describe_files(capture):
        print(f"note: {note}", file=sys.stderr)
    for warning in dict.fromkeys(warnings):
        print(f"warning: {warning}", file=sys.stderr)
    found.save(options.output)
    print(found)


if __name__ == "__main__":
    run_command(main)
