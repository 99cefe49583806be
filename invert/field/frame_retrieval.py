"""Retrieval of the field of one frame: counts, search, refinement, prediction of the held-out pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from correlograph.files.capture import Capture
from correlograph.workers import one_torch_thread
from invert.field.certificate import Prediction, predict_held_out
from invert.field.counts import Calibration, FrameCounts, background_of, read_counts
from invert.field.filtering import filter_counts, intensity_spectrum, variance_transfer
from invert.field.forward_model import ForwardModel
from invert.field.prior import scale_to_signal
from invert.field.refinement import Refinement
from invert.field.search import Search

BRIGHT_STEPS, DIM_STEPS = 150, 800
"""Steps of a search at `BRIGHT_PHOTONS` or more, and at `DIM_PHOTONS` or fewer photons per grain."""

BRIGHT_PHOTONS, DIM_PHOTONS = 15.0, 5.0
"""Photons per speckle grain of the bounding box; see `BRIGHT_STEPS`."""

WARM_FRACTION = 0.4
"""Steps of a search from the field of an earlier pass, as a fraction of those from a random field."""

REFINEMENT_STEPS = 30
"""Steps of conjugate gradients."""

FRAMES_FOR_CALIBRATION = 8
"""Number of frames from which gain, read noise and background are estimated."""

SEARCH_STREAM, HELD_OUT_STREAM = 1_000_003, 7_368_787
"""Factors of the seeds of random fields and of held-out pixels, so that both differ between frames and seeds."""

Outcome = tuple[torch.Tensor, Prediction]
"""Field of one frame (modes, box rows, box columns), and its prediction of the held-out pixels."""


@dataclass(frozen=True)
class FrameRetrieval:
    """What the frames of a capture share.

    Attributes:
        uneven_patch: patch of the estimate if the illumination is uneven.
        modes: number of polarisation modes.
        background: expected counts of a binned pixel without light of the object.
        steps: steps of a search from a random field.
    """

    capture: Capture
    model: ForwardModel
    calibration: Calibration
    uneven_patch: tuple[int, int] | None
    seed: int
    device: str = "cpu"
    modes: int = 1
    background: float = 0.0
    steps: int = BRIGHT_STEPS

    def counts(self, number: int) -> FrameCounts:
        """Return the counts of a frame, with all of the mean counted as signal."""
        rng = torch.Generator().manual_seed((self.seed + 1) * HELD_OUT_STREAM + number)
        frame, used = self.capture.frames[number], self.capture.measured
        return read_counts(frame, self.calibration, self.model.grid, rng, self.uneven_patch, used)

    def calibrate(self, prior: torch.Tensor, modes: int) -> tuple[FrameRetrieval, float]:
        """Return the retrieval with a number of polarisation modes, and the photons per grain."""
        with one_torch_thread():
            first = [self.counts(number) for number in range(min(len(self.capture.frames), FRAMES_FOR_CALIBRATION))]
            kept = variance_transfer(intensity_spectrum(prior, self.model), self.model)
            grains = float(prior.sum() ** 2 / prior.square().sum()) * self.model.grid.measured_fraction
            background = background_of(first, kept, grains, modes)
        signal = max(float(np.mean([one.signal + one.background for one in first])) - background, 1e-6)
        photons = signal * self.model.grid.cells_per_grain
        return replace(self, modes=modes, background=background, steps=search_steps(photons)), photons

    def retrieve(self, job: tuple[torch.Tensor, int, torch.Tensor | None]) -> Outcome:
        """Return the field of one frame, and how well it predicts the held-out counts.

        Args:
            job: prior, number of the frame, and its field of an earlier pass.
        """
        prior, number, start = job
        counts = self.counts(number).with_background(self.background).to(self.device)
        model = replace(self.model, transfer=self.model.transfer.to(self.device))
        prior, start = prior.to(self.device), None if start is None else start.to(self.device)
        target = filter_counts(counts, intensity_spectrum(prior, model, self.modes), model)
        search = Search(model, counts, target, prior, self.modes)
        if start is None:
            start = search.random_field(torch.Generator().manual_seed(self.seed * SEARCH_STREAM + number))
            found = search.run(start, self.steps)
        else:
            found = search.run(start, round(WARM_FRACTION * self.steps))
        refinement = Refinement(model, counts, scale_to_signal(prior, counts.signal / self.modes, model.grid))
        state = refinement.run(found, REFINEMENT_STEPS)
        filtered = counts.illumination * model.grid.on_frame(model.blur(target)) + counts.background
        return refinement.field(state).cpu(), predict_held_out(counts, refinement.expected(state), filtered)


def search_steps(photons_per_grain: float) -> int:
    """Return the number of steps of a search: more in dim frames."""
    dimness = np.log(BRIGHT_PHOTONS / max(photons_per_grain, 1e-9)) / np.log(BRIGHT_PHOTONS / DIM_PHOTONS)
    return round(BRIGHT_STEPS * (DIM_STEPS / BRIGHT_STEPS) ** float(np.clip(dimness, 0.0, 1.0)))
