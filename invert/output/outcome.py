"""Outcome of a reconstruction: albedo, confidence, warnings, and the comparison with a truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from invert.albedo.metrics import aligned_pearson
from invert.albedo.posterior import Samples
from invert.assess.doubts import Doubt
from invert.assess.hypotheses import Hypothesis
from invert.assess.speckle_test import SpeckleTest
from invert.field.reconstruction import FieldReconstruction
from invert.measure.estimate import Estimate
from invert.measure.spectrum import Measurement
from invert.methods import Reconstruction
from invert.output.truth import Comparison, Truth, compare_fine
from invert.tracking.track import Track


@dataclass(frozen=True)
class MethodSettings:
    """Names of method and quality, and the seed."""

    method: str
    quality: str
    seed: int


@dataclass(frozen=True)
class Outcome:
    """A reconstruction with the estimate and the measurement that it is based on.

    Attributes:
        measurement: noise level and Fourier modulus read from the estimate.
        seconds: duration of reading, autocorrelation and retrieval.
        speckle_test: test whether the light is speckle of the reconstructed object; None if no object was found.
        doubts: possible faults that the data can show, each with its measured value and its threshold.
        hypotheses: probability of each explanation of the frames; empty for a result of an earlier version.
        warnings: the doubts that were raised, which lower the confidence, and observations about the frames.
        notes: limits set by the frames: the light that a detection would need, and where the confidence is calibrated.
        fields: field of each frame and the fine albedo, if they were retrieved and accepted; otherwise None.
        track: path of the object, if it moves while the laser is at rest; None for one that is loaded from a folder, whose result.json
            holds its numbers.
    """

    estimate: Estimate
    measurement: Measurement
    reconstruction: Reconstruction
    settings: MethodSettings
    seconds: dict[str, float]
    speckle_test: SpeckleTest | None = None
    doubts: tuple[Doubt, ...] = ()
    hypotheses: dict[Hypothesis, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    fields: FieldReconstruction | None = None
    track: Track | None = None

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
        return f"{type(self).__name__}({found}, confidence {self.confidence:.2f}, {method}, {self.seconds_total:.1f} s{warned})"

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

    def settings_as_dict(self) -> dict[str, Any]:
        """Return method, quality, seed, warnings, notes, speckle test, doubts, hypotheses and track for JSON."""
        test = None if self.speckle_test is None else self.speckle_test.as_dict()
        said = {"warnings": list(self.warnings), "notes": list(self.notes)}
        doubts = [one.as_dict() for one in self.doubts]
        hypotheses = {one.value: probability for one, probability in self.hypotheses.items()}
        track = None if self.track is None else self.track.as_dict()
        return asdict(self.settings) | said | {"speckle_test": test, "doubts": doubts, "hypotheses": hypotheses, "track": track}
