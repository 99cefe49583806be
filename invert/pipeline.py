"""Public API of the inversion: frames, a path or a published autocorrelation to a reconstruction."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from correlograph.errors import InputError, check_device
from correlograph.files.capture import CameraFacts, Capture
from correlograph.files.corrections import Corrections
from correlograph.lags import LAG_SIDE
from invert.assess.reliability import trusted
from invert.assess.speckle_test import SpeckleTest, speckle_test
from invert.blur_fit import likelihood_as_seen, with_blur_found
from invert.measure.capture import check_frame, read_capture
from invert.measure.estimate import Estimate, Patch, check_power, estimate_from_frames, published_estimate
from invert.measure.spectrum import Measurement, read_measurement
from invert.methods import Reconstruction, iterations, retrieve
from invert.output.result_files import write_result
from invert.solvers.base import Progress
from radiometry.estimation.whole_frames import Mean

Source = Capture | str | Path | np.ndarray | Sequence[np.ndarray]


@dataclass(frozen=True)
class Result:
    """A reconstruction with the estimate that it was made from.

    Attributes:
        measurement: noise level and Fourier modulus read from the estimate.
        settings: method, quality and seed.
        seconds: of reading, autocorrelation and retrieval.
        speckle_test: whether the light is speckle of this object; None where none was found.
        warnings: what was found in the frames, and why the confidence is low.
    """

    estimate: Estimate
    measurement: Measurement
    reconstruction: Reconstruction
    settings: dict[str, Any]
    seconds: dict[str, float]
    speckle_test: SpeckleTest | None = None
    warnings: tuple[str, ...] = ()

    @property
    def albedo(self) -> np.ndarray:
        """float32 (64, 64), one pixel a lag, largest value 1; zero where no object was found."""
        return self.reconstruction.albedo

    @property
    def confidence(self) -> float:
        return self.reconstruction.confidence

    @property
    def object_found(self) -> bool:
        return self.reconstruction.object_found

    def save(self, folder: str | Path, truth: np.ndarray | None = None, request_sha256: str | None = None) -> dict[str, Any]:
        """Write what `python -m invert` writes; returns the content of result.json.

        Args:
            request_sha256: digest of all that the result depends on, by which a later run recognises it.
        """
        from correlograph.files.output import output_folder

        test = self.speckle_test
        said = {"warnings": list(self.warnings), "speckle_test": None if test is None else test.as_dict(),
                "request_sha256": request_sha256}
        return write_result(output_folder(folder), self.estimate, self.measurement, self.reconstruction, truth,
                            self.settings | said, self.seconds)


def reconstruct(source: Source, *, method: str = "unet", quality: str = "balanced", patch: Patch = None,
                camera: CameraFacts | None = None, corrections: Corrections | None = None, blur_pixels: float | None = None,
                weights: str | Path | None = None, seed: int = 0, device: str = "cpu", mean: Mean = "auto") -> Result:
    """Reconstruct the hidden object's albedo.

    Args:
        source: a capture; a frame file or a folder of them; frames (n, H, W) or (H, W); or a published
            autocorrelation, a file or array of 127 x 127 lags.
        patch: size in pixels; chosen from the lag pitch where None, and from the object's width as well where "fit".
        camera: facts for frames that carry none.
        corrections: dark frame, flat field and mask.
        blur_pixels: standard deviation of a known Gaussian blur of the frames; where None, one is looked for.
        mean: of the frames, that is subtracted; see `radiometry.estimation.whole_frames`.

    Raises InputError for what cannot be inverted.
    """
    check_device(device)
    begin = time.perf_counter()
    capture = _as_capture(source, camera or CameraFacts())
    if corrections is not None and isinstance(capture, Capture):
        capture = corrections.of(capture)
    read_s = time.perf_counter() - begin
    estimate = capture if isinstance(capture, Estimate) else estimate_from_frames(capture, patch, device, mean, blur_pixels)
    return retrieved(estimate, method=method, quality=quality, weights=weights, seed=seed, device=device, read_s=read_s)


def retrieved(estimate: Estimate, *, method: str, quality: str, weights: str | Path | None = None, seed: int = 0,
              device: str = "cpu", read_s: float = 0.0, progress: Progress = lambda: None) -> Result:
    """Read an estimate's noise, find a blur that the frames may have, and retrieve the albedo."""
    begin = time.perf_counter()
    estimate, draft = with_blur_found(estimate, lambda seen, number: retrieve(seen, "unet", "fast", seed + number, device))
    measurement = read_measurement(estimate.lags, estimate.quantisation, estimate.transfer)
    file = None if weights is None else Path(weights)
    if draft is not None and (method, quality, file) == ("unet", "fast", None):
        reconstruction = draft
    else:
        reconstruction = retrieve(measurement, method, quality, seed, device, progress, file)
    test = speckle_test(estimate, measurement, reconstruction.albedo) if reconstruction.object_found else None
    reconstruction, warnings = trusted(reconstruction, test, measurement, likelihood_as_seen(estimate), estimate.facts)
    seconds = {"read": read_s, "autocorrelation": estimate.seconds, "retrieval": time.perf_counter() - begin}
    settings = {"method": method, "quality": quality, "seed": seed}
    return Result(estimate, measurement, reconstruction, settings, seconds, test, tuple(warnings))


def steps(method: str, quality: str) -> int:
    """How often `retrieved` reports progress."""
    return iterations(method, quality)


def _as_capture(source: Source, camera: CameraFacts) -> Capture | Estimate:
    if isinstance(source, Capture):
        return source
    if isinstance(source, (str, Path)):
        path = Path(source)
        return published_estimate(path) if path.is_file() and _is_published(path) else read_capture([path], camera)
    array = np.asarray(source)
    if array.ndim == 2 and array.shape == (LAG_SIDE, LAG_SIDE):
        check_power(array, "the array")
        return Estimate("autocorrelation", np.asarray(array, np.float32))
    if array.ndim == 2:
        array = array[None]
    if array.ndim != 3 or array.dtype.kind not in "uif" or len(array) == 0:
        raise InputError("frames", "numbers of shape (frames, height, width)", f"{array.dtype} of shape {array.shape}",
                         "give one channel of intensity")
    frames = [np.asarray(frame, np.float32) for frame in array]
    for number, frame in enumerate(frames):
        check_frame(frame, Path(f"frame {number}"))
    return Capture(frames, camera, tuple(f"frame {number}" for number in range(len(frames))))


def _is_published(path: Path) -> bool:
    """Whether a file has the shape of a published autocorrelation."""
    from correlograph.files.images import read_picture

    return read_picture(path)[0].shape in ((LAG_SIDE, LAG_SIDE), (LAG_SIDE, 2 * LAG_SIDE))
