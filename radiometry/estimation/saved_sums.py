"""A file with the sums over the frames of a capture, from which a later run continues."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import torch

from correlograph.files.file_frames import frame_digest
from correlograph.files.output import atomic
from correlograph.version import code_sha256
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator
from radiometry.estimation.frame_sums import FrameSums
from radiometry.estimation.pixel_faults import PixelFaults

INTERVAL_S = 20.0
"""Minimum time between two writings of the file."""


class SavedSums:
    """Sums over the first frames of a capture, in an NPZ file. The sums of later frames are added to them."""

    def __init__(self, file: Path) -> None:
        self._file, self._written_s, self._frames = file, time.monotonic(), 0

    def continue_with(self, estimator: AutocorrelationEstimator, frames: Sequence[np.ndarray]) -> None:
        """Let an estimator, which has the first frames, continue from the file if that holds more frames of the same capture.

        The capture is the same if the digests of all frames are. A file of another capture, of other patches, or one that is damaged, is
        ignored.
        """
        try:
            with open(self._file, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
                saved = _sums_of(archive, estimator)
        except (OSError, ValueError, KeyError, EOFError, TypeError, BadZipFile):
            return
        if not estimator.frames <= saved.frames <= len(frames):
            return
        if any(frame_digest(frames[number]) != digest for number, digest in enumerate(saved.digests)):
            return
        saved.narrow, saved.noise = estimator.sums.narrow, estimator.sums.noise
        estimator.sums, self._frames = saved, saved.frames

    def write(self, estimator: AutocorrelationEstimator, *, is_complete: bool) -> None:
        """Write the sums, at most every `INTERVAL_S` seconds until they are complete."""
        is_due = is_complete or time.monotonic() - self._written_s > INTERVAL_S
        if not is_due or estimator.frames == self._frames:
            return
        sums = estimator.sums
        faults = sums.faults
        content = {
            "key": np.array(_key(estimator)),
            "levels": np.array(sums.levels),
            "digests": np.frombuffer(b"".join(sums.digests), np.uint8).reshape(sums.frames, -1),
            "spectrum": sums.spectrum.cpu().numpy(),
            "power": sums.power.cpu().numpy(),
            "faults": np.array([faults.hot_pixels, faults.lines, sums.spectral_lines]),
            "saturated": np.array(faults.saturated),
            "shift_pixels": np.array(sums.shift_pixels or ()),
        }
        content["sha256"] = np.array(_sha256(content))
        with atomic(self._file) as partial, open(partial, "wb") as stream:
            np.savez(stream, allow_pickle=False, **content)
        self._written_s, self._frames = time.monotonic(), sums.frames


def _key(estimator: AutocorrelationEstimator) -> str:
    """Return the properties of the estimator on which the sums depend."""
    grid = estimator.grid
    return json.dumps([code_sha256(), estimator.mean, grid.frame_shape, grid.patch_shape, grid.lags, estimator.padded])


def _sha256(content: Mapping[str, np.ndarray]) -> str:
    whole = hashlib.sha256()
    for name in sorted(content):
        if name != "sha256":
            whole.update(f"{name} {content[name].dtype} {content[name].shape}".encode() + content[name].tobytes())
    return whole.hexdigest()


def _sums_of(archive: np.lib.npyio.NpzFile, estimator: AutocorrelationEstimator) -> FrameSums:
    """Return the saved sums. Raises ValueError for those of another estimator and for damaged ones."""
    content = {name: archive[name] for name in archive.files}
    if str(content["key"]) != _key(estimator):
        raise ValueError("sums of another estimator")
    if str(content["sha256"]) != _sha256(content):
        raise ValueError("damaged sums")
    hot_pixels, lines, spectral_lines = map(int, content["faults"])
    shift = content["shift_pixels"]
    return FrameSums(
        levels=content["levels"].tolist(),
        digests=[one.tobytes() for one in content["digests"]],
        spectrum=torch.from_numpy(content["spectrum"]),
        power=torch.from_numpy(content["power"]),
        faults=PixelFaults(hot_pixels, lines, float(content["saturated"])),
        spectral_lines=spectral_lines,
        shift_pixels=(float(shift[0]), float(shift[1])) if len(shift) else None,
    )
