"""Result of a reconstruction: an outcome with its figures and files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from correlograph.errors import InputError, check_positive
from correlograph.files.figures import figure_as_html, show_figure
from correlograph.files.manifest import claim
from correlograph.files.output import output_folder, path_of
from correlograph.ranges import CONFIDENCE
from invert.albedo.posterior import Samples
from invert.assess.doubts import Doubt
from invert.assess.hypotheses import Hypothesis
from invert.assess.speckle_test import SpeckleTest
from invert.field.reconstruction import FieldReconstruction
from invert.measure.estimate import Estimate
from invert.measure.spectrum import read_measurement
from invert.methods import Reconstruction
from invert.output.outcome import MethodSettings, Outcome
from invert.output.report import draw_report
from invert.output.result_files import RESULT_FILES, write_result
from invert.output.truth import Truth

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Result(Outcome):
    """An outcome that can be drawn, saved and loaded; the attributes are those of `Outcome`."""

    def _repr_html_(self) -> str:
        return figure_as_html(self.plot(), repr(self))

    def plot(self, truth: Truth | np.ndarray | None = None) -> Figure:
        """Return the report as a matplotlib figure.

        Args:
            truth: known albedo to plot next to the registered reconstruction.
        """
        return draw_report(self, None if truth is None else self.compare(truth))

    def show(self, truth: Truth | np.ndarray | None = None) -> None:
        """Open the report in a window, or below a notebook cell."""
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
            doubts = tuple(Doubt.from_dict(one) for one in summary.get("doubts", ()))
            hypotheses = {Hypothesis(name): float(share) for name, share in summary.get("hypotheses", {}).items()}
            settings = MethodSettings(*(summary[name] for name in ("method", "quality", "seed")))
            warnings, notes = (tuple(map(str, list(summary.get(name, ())))) for name in ("warnings", "notes"))
            seconds = {str(name): float(value) for name, value in summary["seconds"].items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, RecursionError) as error:
            found = f"{type(error).__name__} in {path} ({error!s:.80})"
            raise InputError("result", "a folder that python -m invert wrote", found, "check the path") from None
        told = (test, doubts, hypotheses, warnings, notes, fields or None)
        return cls(estimate, read_measurement(lags), reconstruction, settings, seconds, *told)
