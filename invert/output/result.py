"""Result of a reconstruction: albedo, confidence, warnings, with figures, files and a summary for JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from correlograph.errors import InputError, check_positive
from correlograph.files.output import path_of
from correlograph.ranges import CONFIDENCE
from invert.albedo.metrics import aligned_pearson
from invert.albedo.posterior import Samples
from invert.assess.speckle_test import SpeckleTest
from invert.field.reconstruction import FieldReconstruction
from invert.measure.estimate import Estimate
from invert.measure.spectrum import Measurement, read_measurement
from invert.methods import Reconstruction
from invert.output.truth import Comparison, Truth, compare_fine

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Settings:
    """Names of method and quality, and the seed."""

    method: str
    quality: str
    seed: int


@dataclass(frozen=True)
class Result:
    """A reconstruction with the estimate and the measurement that it is based on.

    Attributes:
        measurement: noise level and Fourier modulus read from the estimate.
        seconds: duration of reading, autocorrelation and retrieval.
        speckle_test: test whether the light is speckle of the reconstructed object; None if no object was found.
        warnings: observations about the frames, and reasons for a low confidence.
        notes: limits set by the frames: the light that a detection would need, and where the confidence is calibrated.
        fields: field of each frame and the fine albedo, if they were retrieved and accepted; otherwise None.
    """

    estimate: Estimate
    measurement: Measurement
    reconstruction: Reconstruction
    settings: Settings
    seconds: dict[str, float]
    speckle_test: SpeckleTest | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    fields: FieldReconstruction | None = None

    @property
    def albedo(self) -> np.ndarray:
        """float32 (64, 64), or larger with more lags; one pixel per lag, maximum 1; zero if no object was found. With fields,
        each lag is divided into `fields.cells_per_lag` pixels along both axes.
        """
        return self.coarse_albedo if self.fields is None else self.fields.albedo

    @property
    def coarse_albedo(self) -> np.ndarray:
        """The albedo from the autocorrelation alone, one pixel per lag."""
        return self.reconstruction.albedo

    @property
    def pitches_m(self) -> tuple[float, float] | None:
        """Width of a pixel of the albedo along rows and columns; None if the camera is unknown."""
        lags = self.estimate.pitches_m
        return (
            lags
            if lags is None or self.fields is None
            else (
                lags[0] / self.fields.cells_per_lag,
                lags[1] / self.fields.cells_per_lag,
            )
        )

    @property
    def confidence(self) -> float:
        """0 to 1; see `Reconstruction.confidence`."""
        return self.reconstruction.confidence

    @property
    def object_found(self) -> bool:
        """Whether an object was found."""
        return self.reconstruction.object_found

    @property
    def samples(self) -> Samples | None:
        """Samples of the posterior; None for classical methods and for `fast`."""
        return self.reconstruction.posterior

    @property
    def seconds_total(self) -> float:
        """Duration of all steps."""
        return sum(self.seconds.values())

    def __repr__(self) -> str:
        found = "object found" if self.object_found else "no object found"
        method = f"{self.settings.method}:{self.settings.quality}"
        warned = f", {len(self.warnings)} warnings" if self.warnings else ""
        return f"Result({found}, confidence {self.confidence:.2f}, {method}, {self.seconds_total:.1f} s{warned})"

    def _repr_html_(self) -> str:
        from correlograph.files.figures import figure_as_html

        return figure_as_html(self.plot(), repr(self))

    def truth_on_lags(self, truth: Truth | np.ndarray | None) -> np.ndarray | None:
        """Return a truth on the lags of this result. Raises InputError for one that cannot be resampled."""
        if truth is None:
            return None
        known = truth if isinstance(truth, Truth) else Truth(truth)
        return known.on_lags(len(self.coarse_albedo), self.estimate.pitches_m)

    def compare(self, truth: Truth | np.ndarray) -> Comparison:
        """Register the albedo to a truth and correlate them, on pixels of the coarser of the two.

        Raises InputError for a truth that cannot be resampled.
        """
        known = truth if isinstance(truth, Truth) else Truth(truth)
        if self.fields is not None:
            return compare_fine(self.albedo, self.pitches_m, known, self.fields.cells_per_lag)
        on_lags = known.on_lags(len(self.albedo), self.estimate.pitches_m)
        return Comparison(*aligned_pearson(self.albedo, on_lags), on_lags)

    def plot(self, truth: Truth | np.ndarray | None = None) -> Figure:
        """Return the report as a matplotlib figure.

        Args:
            truth: known albedo to plot next to the registered reconstruction.
        """
        from invert.output.report import draw_report

        return draw_report(self, None if truth is None else self.compare(truth))

    def show(self, truth: Truth | np.ndarray | None = None) -> None:
        """Open the report in a window, or below a notebook cell."""
        from correlograph.files.figures import show_figure

        show_figure(self.plot(truth))

    def save(
        self,
        folder: str | Path,
        truth: Truth | np.ndarray | None = None,
        request_sha256: str | None = None,
        *,
        fields: bool = False,
        overwrite: bool = False,
    ) -> dict[str, Any]:
        """Write the files that `python -m invert` writes; return the content of result.json.

        Args:
            truth: known albedo to compare with; a `Truth` has a pitch and is resampled to the lags.
            request_sha256: digest of everything that the result depends on; a later run recognises the result by it.
            fields: whether to write the field of each frame as well (fields.npz).
            overwrite: whether to replace files of these names that this program did not write.

        Raises InputError for such files without `overwrite`.
        """
        from correlograph.files.manifest import claim
        from correlograph.files.output import output_folder
        from invert.output.result_files import RESULT_FILES, write_result

        if not isinstance(request_sha256, (str, type(None))):
            raise InputError("request_sha256", "a text or None", f"{request_sha256!r:.60}", "omit it")
        target = output_folder(folder)
        claim(target, RESULT_FILES, overwrite=overwrite)
        return write_result(target, self, truth, request_sha256, fields=fields)

    @classmethod
    def load(cls, folder: str | Path) -> Result:
        """Load a saved result. Its measurement is read from the saved autocorrelation, without the camera's transfer.

        Raises InputError for a folder without a complete result.
        """
        path = path_of("result", folder)
        try:
            summary = json.loads((path / "result.json").read_text())
            albedo, lags = (np.load(path / name, allow_pickle=False) for name in ("albedo.npy", "autocorrelation.npy"))
            posterior = summary["posterior"]
            samples = posterior and Samples(np.load(path / "samples.npy", allow_pickle=False), posterior.get("size_errors"))
            fields = summary.get("fields") and FieldReconstruction.load(path, albedo, summary["fields"])
            coarse = np.load(path / "albedo_coarse.npy", allow_pickle=False) if fields else albedo
            if fields and len(albedo) != len(coarse) * fields.cells_per_lag:
                raise ValueError("albedo_coarse.npy")
            if lags.shape != (2 * len(coarse) - 1,) * 2 or not np.isfinite(lags).all():
                raise ValueError("autocorrelation.npy")
            pitches = summary["lag_pitches_m"] if fields else summary["pitches_m"]
            pitches = pitches and tuple(check_positive("pitch", pitch) for pitch in pitches)
            if pitches is not None and len(pitches) != 2:
                raise ValueError("pitches_m")
            estimate = Estimate(summary["input"], lags, pitches_m=pitches)
            reconstruction = Reconstruction(
                Truth(coarse, name="albedo_coarse.npy" if fields else "albedo.npy").albedo,
                summary["object_found"] is True,
                CONFIDENCE.check("confidence", summary["confidence"]),
                summary["residual"] and float(summary["residual"]),
                tuple(map(float, summary["phase_retrieval_transfer"])),
                samples,
            )
            test = SpeckleTest.from_dict(summary["speckle_test"])
            settings = Settings(*(summary[name] for name in ("method", "quality", "seed")))
            warnings, notes = (tuple(map(str, list(summary.get(name, ())))) for name in ("warnings", "notes"))
            seconds = {str(name): float(value) for name, value in summary["seconds"].items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, RecursionError) as error:
            found = f"{type(error).__name__} in {path} ({error!s:.80})"
            raise InputError("result", "a folder that python -m invert wrote", found, "check the path") from None
        return cls(estimate, read_measurement(lags), reconstruction, settings, seconds, test, warnings, notes, fields or None)

    def settings_as_dict(self) -> dict[str, Any]:
        """Return method, quality, seed, warnings, notes and speckle test for JSON."""
        test = None if self.speckle_test is None else self.speckle_test.as_dict()
        return asdict(self.settings) | {"warnings": list(self.warnings), "notes": list(self.notes), "speckle_test": test}
