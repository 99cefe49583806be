"""Captures among the inputs, how they are to be inverted, and one of them inverted into its folder of results."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.errors import InputError
from correlograph.files.capture import CameraFacts
from correlograph.files.capture_folder import check_whole
from correlograph.files.corrections import Corrections
from correlograph.files.output import output_folder, sole_writer
from correlograph.version import version
from invert.measure.capture import find_frames, frames_inside, printable, read_capture
from invert.measure.estimate import Estimate, Patch, estimate_from_frames, published_estimate
from invert.network.checkpoints import SHIPPED, load_network
from invert.output.result_files import check_truth_pitch, read_truth
from invert.pipeline import retrieved
from invert.solvers.base import Progress
from radiometry.estimation.whole_frames import Mean

REVISION = 7
"""To be raised when the same request gives another result."""

Captures = dict[str, tuple[Path, ...]]
"""Files of each capture, keyed by the name of its folder of results; the key is empty for a capture given alone."""


@dataclass(frozen=True)
class Request:
    """How captures are to be inverted; as the options of `python -m invert` say."""

    autocorrelation: bool = False
    known: CameraFacts = field(default_factory=CameraFacts)
    corrections: Corrections = field(default_factory=Corrections)
    patch: Patch = None
    mean: Mean = "auto"
    blur_pixels: float | None = None
    method: str = "unet"
    quality: str = "balanced"
    weights: Path | None = None
    truth: Path | None = None
    seed: int = 0
    device: str = "cpu"

    def sha256(self, files: Sequence[Path]) -> str:
        """Of the version, the options, and the bytes of all files that a result depends on."""
        corrections = self.corrections
        weights = self.weights or SHIPPED if self.method == "unet" else None
        whole = hashlib.sha256()
        for file in (*files, corrections.dark, corrections.flat, corrections.mask, weights, self.truth):
            whole.update(hashlib.sha256(file.read_bytes()).digest() if file else b"none")
        options = replace(self, corrections=Corrections(), weights=None, truth=None, device="any")
        return hashlib.sha256(f"{version()} {REVISION} {options}".encode() + whole.digest()).hexdigest()


def find_captures(inputs: Sequence[str], autocorrelation: bool) -> Captures:
    """Captures among inputs: all files given are one; a folder of frames is one; of a folder of such folders each is one.

    Published autocorrelations are one each. Raises InputError for what is not there, for folders that are both, and for two
    captures of one name.
    """
    paths = [Path(item) for item in inputs]
    for path in paths:
        if not path.exists():
            raise InputError("inputs", "files or folders", f"no {path}", "check the path")
    folders = [path for path in paths if path.is_dir()]
    if autocorrelation:
        return {"": (paths[0],)} if len(paths) == 1 else _named((path.stem, (path.resolve(),)) for path in paths)
    if 0 < len(folders) < len(paths):
        raise InputError("inputs", "frames of one capture, or folders of captures", "files and folders mixed",
                         "give the one or the other")
    if not folders:
        return {"": tuple(paths)}
    inside = [_captures_inside(folder) for folder in folders]
    if inside == [[]]:
        return {"": (folders[0],)}
    return _named((one.resolve().name, (one.resolve(),)) for folder, found in zip(folders, inside, strict=True)
                  for one in found or [folder])


def _captures_inside(folder: Path) -> list[Path]:
    """Folders of frames in a folder that holds none itself."""
    check_whole(folder)
    found = sorted(one for one in folder.iterdir() if one.is_dir() and not one.name.startswith(".") and frames_inside(one))
    if found and frames_inside(folder):
        raise InputError("inputs", "a folder of frames, or of captures", f"both in {folder}",
                         f"move the frames beside {found[0].name} elsewhere")
    return found


def _named(found: Iterable[tuple[str, tuple[Path, ...]]]) -> Captures:
    captures: Captures = {}
    for name, files in found:
        if printable(name) in captures:
            raise InputError("inputs", "captures of different names", f"{printable(name)} twice",
                             "rename one; results go to folders of these names")
        captures[printable(name)] = files
    return captures


def check_request(request: Request) -> np.ndarray | None:
    """Refuse files that options name and that cannot be used, before any capture is read; returns the truth."""
    if request.weights:
        load_network(request.weights, "cpu")
    for name, file in vars(request.corrections).items():
        if file and not file.is_file():
            raise InputError(f"--{name}", "a picture of the frames' size", f"no {file}", "check the path")
    return read_truth(request.truth) if request.truth else None


def invert_capture(request: Request, files: Sequence[Path], folder: Path, progress: Progress = lambda: None) -> dict[str, Any]:
    """Invert one capture and write its results into a folder; returns the content of result.json."""
    truth = check_request(request)
    asked = request.sha256(find_frames(files))
    estimate, read_s = _estimate(request, files)
    if request.truth and not request.autocorrelation:
        check_truth_pitch(request.truth, estimate.pitches_m)
    with sole_writer(output_folder(folder)):
        result = retrieved(estimate, method=request.method, quality=request.quality, weights=request.weights,
                           seed=request.seed, device=request.device, read_s=read_s, progress=progress)
        return result.save(folder, truth, asked)


def _estimate(request: Request, files: Sequence[Path]) -> tuple[Estimate, float]:
    """The estimate, and the seconds that reading took."""
    begin = time.perf_counter()
    if request.autocorrelation:
        estimate = published_estimate(files[0])
        return estimate, time.perf_counter() - begin
    capture = request.corrections.of(read_capture(files, request.known))
    read_s = time.perf_counter() - begin
    return estimate_from_frames(capture, request.patch, request.device, request.mean, request.blur_pixels), read_s
