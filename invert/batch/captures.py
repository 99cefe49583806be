"""Captures among the inputs of the command, and the reconstruction of one of them into its folder of results."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata
from correlograph.files.capture_folder import check_complete
from correlograph.files.captured_frames import CONTACT_SHEET, find_frames, frames_inside, printable
from correlograph.files.corrections import Corrections
from correlograph.files.manifest import claim, digest_of
from correlograph.files.output import output_folder, sole_writer
from correlograph.files.raw_frames import description_of
from correlograph.files.stacks import file_of, is_stack
from correlograph.version import version
from invert.choices import BALANCED, UNET, Method, Quality
from invert.measure.estimate import Patch
from invert.network.checkpoints import DEFAULT_WEIGHTS, load_network
from invert.output.result import Result
from invert.output.result_files import RESULT_FILES
from invert.output.truth import Truth
from invert.pipeline import Blur, reconstruct
from invert.solvers.base import Progress, no_progress
from radiometry.estimation.background import MeanModel

REVISION = 17
"""Revision of the results; to be raised whenever a code change alters the result of a request."""

RESERVED_NAMES = {"table.md", "captures.json"}
"""Names of output files next to the folders of results."""

SUMS_FILE = "frame_sums.npz"
"""File in the folder of results that keeps the sums over the frames of a capture above 1 GB."""

Captures = dict[str, tuple[Path, ...]]
"""Files of each capture by the name of its folder of results; the name is empty for a single capture."""


@dataclass(frozen=True)
class Request:
    """Options of `python -m invert` that a result depends on."""

    autocorrelation: bool = False
    camera: CameraMetadata = field(default_factory=CameraMetadata)
    corrections: Corrections = field(default_factory=Corrections)
    patch: Patch = None
    lags: int | None = None
    pitch_m: float | None = None
    mean_model: MeanModel = "auto"
    blur_pixels: Blur = None
    method: Method = UNET
    quality: Quality = BALANCED
    weights: Path | None = None
    truth: Path | None = None
    truth_pitch_m: float | None = None
    seed: int = 0
    device: str = "cpu"
    save_fields: bool = False

    def sha256(self, files: Sequence[Path]) -> str:
        """Return the digest of the version, the options, and the bytes of all files that a result depends on."""
        corrections = self.corrections
        weights = self.weights or DEFAULT_WEIGHTS if self.method.is_network else None
        content = hashlib.sha256()
        descriptions = [path for file in files if (path := description_of(file)) is not None]
        for file in (*files, *descriptions, *corrections.files, weights, self.truth):
            content.update(bytes.fromhex(digest_of(file_of(file))) if file else b"none")
        options = replace(self, corrections=Corrections(), weights=None, truth=None, device="any")
        datasets = [str(file).removeprefix(str(file_of(file))) for file in files]
        text = ", ".join(f"{name}={value}" for name, value in vars(options).items())
        return hashlib.sha256(f"{version()} {REVISION} {text} {datasets}".encode() + content.digest()).hexdigest()

    def reconstruct(
        self, files: Sequence[Path], folder: Path | None = None, scheduler: str | None = None, progress: Progress = no_progress
    ) -> Result:
        """Reconstruct one capture. If it is large, `folder` keeps the sums over its frames, and the workers of a Dask
        scheduler, if one is given, add them.
        """
        return reconstruct(
            files,
            method=self.method,
            quality=self.quality,
            patch=self.patch,
            lags=self.lags,
            pitch_m=self.pitch_m,
            camera=self.camera,
            corrections=self.corrections,
            blur_pixels=self.blur_pixels,
            mean_model=self.mean_model,
            weights=self.weights,
            seed=self.seed,
            device=self.device,
            autocorrelation=self.autocorrelation,
            sums_file=None if folder is None else folder / SUMS_FILE,
            scheduler=scheduler,
            progress=progress,
        )


def find_captures(inputs: Sequence[str], autocorrelation: bool) -> Captures:
    """Find the captures among inputs. All files together are one capture; so is a folder of frames. A folder of such folders
    holds one capture in each. Published autocorrelations are one each.

    Raises InputError for missing inputs, for folders that hold frames and captures, and for two captures of one name.
    """
    paths = [Path(item) for item in inputs]
    for path in paths:
        if not file_of(path).exists():
            raise InputError("inputs", "files or folders", f"no {path}", "check the path")
    folders = [path for path in paths if path.is_dir() and not is_stack(path)]
    if autocorrelation:
        return {"": (paths[0],)} if len(paths) == 1 else _check_names((path.stem, (path.resolve(),)) for path in paths)
    if 0 < len(folders) < len(paths):
        expected = "frames of one capture, or folders of captures"
        raise InputError("inputs", expected, "files and folders mixed", "name either files or folders")
    if not folders:
        return {"": tuple(paths)}
    inside = [_captures_inside(folder) for folder in folders]
    if inside == [[]]:
        return {"": (folders[0],)}
    return _check_names(
        (one.name if one.name.strip(".") else one.resolve().name, (one.resolve(),))
        for folder, found in zip(folders, inside, strict=True)
        for one in found or [folder]
    )


def _captures_inside(folder: Path) -> list[Path]:
    """Return the folders of frames in a folder that holds no frames itself."""
    check_complete(folder)
    found = sorted(one for one in folder.iterdir() if _is_folder(one) and frames_inside(one))
    if found and frames_inside(folder):
        raise InputError(
            "inputs",
            "a folder of frames, or of captures",
            f"both in {folder}",
            f"move the frames next to {found[0].name} elsewhere",
        )
    return found


def _is_folder(path: Path) -> bool:
    """Return whether a path is a visible folder that may hold frames or captures."""
    return path.is_dir() and not path.name.startswith(".") and not is_stack(path)


def skipped_folders(inputs: Sequence[str]) -> list[Path]:
    """Return the folders among the inputs, and directly inside them, that hold files but no frames."""
    folders = [Path(item) for item in inputs if _is_folder(Path(item))]
    inside = [one for folder in folders for one in sorted(folder.iterdir()) if _is_folder(one)]
    return [one for one in inside if not frames_inside(one) and any(path.is_file() for path in one.iterdir())]


def _check_names(found: Iterable[tuple[str, tuple[Path, ...]]]) -> Captures:
    captures: Captures = {}
    for name, files in found:
        if name.startswith(".") or name in RESERVED_NAMES or name.startswith(CONTACT_SHEET):
            expected = "captures whose names can be those of folders of results"
            raise InputError("inputs", expected, printable(name), "rename this capture")
        if printable(name) in captures:
            raise InputError(
                "inputs",
                "captures of different names",
                f"{printable(name)} twice",
                "rename one of them; the folders of results have these names",
            )
        captures[printable(name)] = files
    return captures


def check_request(request: Request) -> None:
    """Refuse unusable files that options name, before any capture is read."""
    if request.weights:
        load_network(request.weights, "cpu")
    for name, file in vars(request.corrections).items():
        if file and not (file.is_file() or (file.is_dir() and name != "mask")):
            several = "" if name == "mask" else ", or a stack or a folder of them"
            raise InputError(f"--{name}", f"an image of the frames' size{several}", f"no {file}", "check the path")
    if request.truth:
        Truth.read(request.truth, request.truth_pitch_m)


def invert_capture(
    request: Request,
    files: Sequence[Path],
    folder: Path,
    progress: Progress = no_progress,
    *,
    overwrite: bool = False,
    scheduler: str | None = None,
) -> tuple[Result, dict[str, object]]:
    """Reconstruct one capture into a folder; return the result and the content of result.json.

    Args:
        overwrite: whether to replace existing files of the same names that this program did not write.
        scheduler: address of a running Dask scheduler, whose workers add the frames of a large capture.
    """
    check_request(request)
    truth = Truth.read(request.truth, request.truth_pitch_m) if request.truth else None
    digest = request.sha256(find_frames(files))
    is_new = not folder.exists()
    try:
        with sole_writer(output_folder(folder)):
            claim(folder, (*RESULT_FILES, SUMS_FILE), overwrite=overwrite)
            result = request.reconstruct(files, folder, scheduler, progress)
            return result, result.save(folder, truth, digest, fields=request.save_fields)
    finally:
        if is_new and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()  # nothing was reconstructed
