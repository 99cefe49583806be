"""The options of a reconstruction, checked once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from pathlib import Path
from typing import Literal, cast

from correlograph.errors import InputError, check_device, check_positive
from correlograph.files.capture import CameraMetadata, Capture
from correlograph.files.corrections import Corrections
from correlograph.files.output import path_of
from correlograph.progress import Progress, no_progress
from correlograph.ranges import BLUR, LAG_COUNT, OBJECT_NUMBER, PATCH, SEED
from invert.choices import (
    BALANCED,
    FIELD,
    UNET,
    Method,
    Quality,
    check_mean_model,
    method_named,
    quality_named,
    retrieves_fields,
)
from radiometry.estimation.background import MeanModel

Patch = int | Literal["fit"] | None
"""Patch size in pixels, or the rule that chooses it."""

Blur = float | Literal["auto"] | None
"""Standard deviation of a Gaussian blur in pixels, "auto" to estimate it, or None for the default of the method."""


@dataclass(frozen=True)
class Request:
    """Options of a reconstruction.

    Attributes:
        method, quality: names, or entries of `invert.choices`.
        patch: patch size in pixels; None derives it from the lag pitch, or takes an eighth of the frame if the camera is unknown;
            "fit" also takes the width of the object into account (`invert.measure.patch_fit`).
        lags: largest lag on either side of zero, 32 to 255; the albedo has lags + 1 pixels along each axis.
        pitch_m: lag pitch. Without patch, lags and pitch, both are adapted to the object (`invert.measure.lag_choice`); if only some
            are given, the others are 63 and 300 um.
        camera: metadata for frames that carry none.
        corrections: dark frame, flat-field frame and mask.
        blur_pixels: standard deviation of a known Gaussian blur in addition to pupil and pixel; "auto" estimates it with the network.
            None also estimates it for methods with a network and assumes no blur for the others, which then run no network.
        mean_model: background model: auto, pooled, fixed or published; see `radiometry.estimation.autocorrelation_estimator`.
        weights: weights of the network instead of those that ship.
        autocorrelation: whether files hold autocorrelations; None decides by their shape.
        sums_file: file (.npz) that keeps the sums over the frames of a capture above 1 GB, so that a later call continues from it.
        scheduler: address of a running Dask scheduler, whose workers add the frames of a capture above 1 GB. They need the same file
            names.
        object_number: number of the object to reconstruct where several move on their own paths, 1 for the brightest. With another
            background model than auto, all are shown together.
        progress: called with the number of steps done since the last call.

    Raises InputError for options out of range, or that do not belong together.
    """

    method: Method = UNET
    quality: Quality = BALANCED
    patch: Patch = None
    lags: int | None = None
    pitch_m: float | None = None
    camera: CameraMetadata | None = None
    corrections: Corrections | None = None
    blur_pixels: Blur = None
    mean_model: MeanModel = "auto"
    weights: Path | None = None
    seed: int = 0
    device: str = "cpu"
    autocorrelation: bool | None = None
    sums_file: Path | None = None
    scheduler: str | None = None
    object_number: int = 1
    progress: Progress = field(default=no_progress, compare=False, repr=False)

    def __post_init__(self) -> None:
        self._set("method", method_named(self.method))
        self._set("quality", quality_named(self.quality))
        self._set("mean_model", check_mean_model(self.mean_model))
        check_device(self.device)
        if not callable(self.progress):
            raise InputError(
                "progress", "a function of a number of steps", f"{self.progress!r:.60}", "provide a function or omit it"
            )
        for name, kind in (("camera", CameraMetadata), ("corrections", Corrections)):
            value = getattr(self, name)
            if value is not None and not isinstance(value, kind):
                raise InputError(name, f"a {kind.__name__}", f"{value!r:.60}", f"create one with correlograph.{kind.__name__}")
        self._check_numbers()
        if self.weights is not None and self.method.weights is None:
            found, remedy = f"method {self.method}", f"select method {UNET} or remove weights"
            raise InputError("weights", f"method {UNET} or {FIELD}", found, remedy)
        for name in ("weights", "sums_file"):
            file = getattr(self, name)
            self._set(name, None if file is None else path_of(name, file))

    def _check_numbers(self) -> None:
        patch, blur = cast(object, self.patch), cast(object, self.blur_pixels)
        if isinstance(patch, Integral):
            self._set("patch", PATCH.check("patch", int(patch)))
        elif not (patch is None or (isinstance(patch, str) and patch == "fit")):
            raise InputError("patch", 'a number of pixels, None or "fit"', f"{patch!r:.60}", "leave it at None")
        if isinstance(blur, Real):
            BLUR.check("blur_pixels", cast(float, blur))
        elif not (blur is None or (isinstance(blur, str) and blur == "auto")):
            raise InputError("blur_pixels", 'a number of pixels, None or "auto"', f"{blur!r:.60}", 'use "auto"')
        if self.lags is not None:
            self._set("lags", LAG_COUNT.check("lags", self.lags))
        if self.pitch_m is not None:
            check_positive("pitch_m", self.pitch_m)
        self._set("seed", SEED.check("seed", self.seed))
        self._set("object_number", OBJECT_NUMBER.check("object_number", self.object_number))
        if self.object_number > 1 and self.mean_model != "auto":
            expected, remedy = "mean model auto together with it", "omit one of them"
            raise InputError("object_number", expected, f"mean model {self.mean_model}", remedy)

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    @property
    def known_blur(self) -> float | None:
        """Blur in pixels if it is known; None otherwise."""
        return None if self.blur_pixels == "auto" else self.blur_pixels

    @property
    def finds_blur(self) -> bool:
        """Whether an unknown blur is searched for."""
        return self.method.weights is not None or self.blur_pixels == "auto"

    @property
    def retrieves_fields(self) -> bool:
        """Whether the field of each frame is retrieved, if there are frames."""
        return retrieves_fields(self.method, self.quality)

    def for_capture(self) -> Request:
        """Return the options for frames in memory that are already corrected and carry their metadata."""
        of_frames = {"camera": None, "corrections": None, "mean_model": "auto", "autocorrelation": None}
        return replace(self, **of_frames, sums_file=None, scheduler=None, object_number=1)

    def for_estimate(self) -> Request:
        """Return the options for an estimate of frames, without those of the frames; method field becomes that of its coarse albedo."""
        method = UNET if self.method == FIELD else self.method
        return replace(self.for_capture(), method=method, patch=None, lags=None, pitch_m=None, blur_pixels=None)

    def check_source(self, source: object) -> None:
        """Raise InputError for metadata given twice."""
        if isinstance(source, Capture) and self.camera is not None:
            raise InputError("camera", "no camera together with a capture, which has its own", "both", "create another Capture")

    def check_estimate(self) -> None:
        """Raise InputError for options that change the estimate of frames, because an autocorrelation is already an estimate."""
        if self.method == FIELD:
            found = "an autocorrelation, which holds no phase of a frame"
            raise InputError("method", "frames for method field", found, f"provide frames, or select method {UNET}")
        given = [name for name in ("patch", "lags", "pitch_m", "blur_pixels") if getattr(self, name) is not None]
        given += ["corrections"] if self.corrections is not None and not self.corrections.is_empty else []
        given += ["mean_model"] if self.mean_model != "auto" else []
        given += ["object_number"] if self.object_number > 1 else []
        if given:
            raise InputError("autocorrelation", "no option that applies to frames", ", ".join(given), "remove these options")
