"""Captures among the inputs of the command, and the reconstruction of one of them into its folder of results."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from correlograph.errors import InputError
from correlograph.files.capture_folder import check_complete
from correlograph.files.captured_frames import CONTACT_SHEET, find_frames, frames_inside, printable
from correlograph.files.corrections import Corrections
from correlograph.files.manifest import claim, digest_of
from correlograph.files.output import output_folder, sole_writer
from correlograph.files.raw_frames import description_of
from correlograph.files.stacks import file_of, is_stack
from correlograph.version import code_sha256
from invert.network.checkpoints import load_network
from invert.output.result import Result
from invert.output.result_files import RESULT_FILES
from invert.output.truth import Truth
from invert.pipeline import fulfil
from invert.request import Request

RESERVED_NAMES = {"table.md", "captures.json"}
"""Names of output files next to the folders of results."""

SUMS_FILE = "frame_sums.npz"
"""File in the folder of results that keeps the sums over the frames of a capture above 1 GB."""

_NO_PART_OF_A_RESULT = {"corrections", "weights", "device", "sums_file", "scheduler", "progress"}
"""Options that do not enter the digest of a job: files, whose content does, and where and how the work is done."""

Captures = dict[str, tuple[Path, ...]]
"""Files of each capture by the name of its folder of results; the name is empty for a single capture."""


@dataclass(frozen=True)
class Job:
    """The work of `python -m invert` on each capture.

    Attributes:
        request: options of the reconstruction.
        truth, truth_pitch_m: file of a known albedo, and its pixel pitch.
        save_fields: whether the field of each frame is written as well.
    """

    request: Request
    truth: Path | None = None
    truth_pitch_m: float | None = None
    save_fields: bool = False

    def sha256(self, files: Sequence[Path]) -> str:
        """Return the digest of the code, the options, and the bytes of all files that a result depends on."""
        request, corrections = self.request, self.request.corrections or Corrections()
        content = hashlib.sha256()
        descriptions = [path for file in files if (path := description_of(file)) is not None]
        weights = request.weights or request.method.weights
        for file in (*files, *descriptions, *corrections.files, weights, self.truth):
            content.update(bytes.fromhex(digest_of(file_of(file))) if file else b"none")
        options = {name: value for name, value in vars(request).items() if name not in _NO_PART_OF_A_RESULT}
        datasets = [str(file).removeprefix(str(file_of(file))) for file in files]
        text = f"{options} {self.truth_pitch_m} {self.save_fields}"
        return hashlib.sha256(f"{code_sha256()} {text} {datasets}".encode() + content.digest()).hexdigest()

    def check(self) -> Truth | None:
        """Refuse unusable files that options name, before any capture is read; return the known albedo, if there is one."""
        if self.request.weights:
            load_network(self.request.weights, "cpu")
        (self.request.corrections or Corrections()).check()
        return Truth.read(self.truth, self.truth_pitch_m) if self.truth else None

    def run(self, files: Sequence[Path], folder: Path, *, overwrite: bool = False) -> tuple[Result, dict[str, object]]:
        """Reconstruct one capture into a folder; return the result and the content of result.json.

        Args:
            overwrite: whether to replace existing files of the same names that this program did not write.
        """
        truth = self.check()
        digest, is_new = self.sha256(find_frames(files)), not folder.exists()
        try:
            with sole_writer(output_folder(folder)):
                claim(folder, (*RESULT_FILES, SUMS_FILE), overwrite=overwrite)
                result = fulfil(replace(self.request, sums_file=folder / SUMS_FILE), files)
                return result, result.save(folder, truth, digest, fields=self.save_fields)
        finally:
            if is_new and folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()  # nothing was reconstructed


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
    """Return the folders directly inside those among the inputs that hold no frames, but are empty or hold other files."""
    folders = [Path(item) for item in inputs if _is_folder(Path(item))]
    inside = [one for folder in folders for one in sorted(folder.iterdir()) if _is_folder(one)]
    contents = {one: list(one.iterdir()) for one in inside if not frames_inside(one)}
    return [one for one, paths in contents.items() if not paths or any(path.is_file() for path in paths)]


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
