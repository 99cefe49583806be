"""Retrieval of the field of one frame: counts, search, sampling, prediction of the held-out pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from correlograph.files.capture import Capture
from correlograph.workers import one_torch_thread
from invert.field.certificate import Prediction, predict_held_out
from invert.field.counts import Calibration, FrameCounts, background_of, read_counts
from invert.field.filtering import filter_counts, intensity_spectrum, variance_transfer
from invert.field.forward_model import ForwardModel, expected_counts
from invert.field.posterior import FieldPosterior
from invert.field.prior import scale_to_signal
from invert.field.sampling import Sampling
from invert.field.search import Search

BRIGHT_STEPS, DIM_STEPS = 150, 800
"""Steps of a search at `BRIGHT_PHOTONS` or more, and at `DIM_PHOTONS` or fewer photons per grain."""

BRIGHT_PHOTONS, DIM_PHOTONS = 15.0, 5.0
"""Photons per speckle grain of the bounding box; see `BRIGHT_STEPS`."""

WARM_FRACTION = 0.4
"""Steps of a search from the field of an earlier pass, as a fraction of those from a random field."""

WARM_UP_FRACTION, SAMPLES_FRACTION = 0.05, 0.1
"""Langevin steps that are discarded, and that are averaged, as fractions of the steps of a search from a random field."""

FRAMES_FOR_CALIBRATION = 8
"""Number of frames from which gain, read noise and background are estimated."""

SEARCH_STREAM, HELD_OUT_STREAM, SAMPLING_STREAM = 1_000_003, 7_368_787, 15_485_863
"""Factors of the seeds of random fields, of held-out pixels and of samples, so that they differ between frames and seeds."""


@dataclass(frozen=True)
class FrameOutcome:
    """Mean field of one frame over samples of its posterior (modes, box rows, box columns), mean of |E|^2 alike, prediction of its
    held-out pixels, and expected signal per binned pixel.
    """

    field: torch.Tensor
    power: torch.Tensor
    prediction: Prediction
    signal: float


@dataclass(frozen=True)
class FrameRetrieval:
    """State that the frames of a capture share.

    Attributes:
        numbers: frames of the capture that are used.
        coarse_prior: prior from the coarse albedo (box rows, box columns).
        uneven_patch: patch of the estimate if the illumination is uneven.
        modes: number of polarisation modes.
        background: expected counts of a binned pixel without light of the object, shift of the calibration included.
        dark: the same without any light.
        filter_background: background of the Wiener filter with which all predictions are compared.
        signal: expected counts of a binned pixel by light of the object.
        effort: steps of the search as a fraction of `search_steps`.
        steps: steps of a search from a random field.
    """

    capture: Capture
    numbers: tuple[int, ...]
    model: ForwardModel
    calibration: Calibration
    coarse_prior: torch.Tensor
    uneven_patch: tuple[int, int] | None
    seed: int
    device: str = "cpu"
    effort: float = 1.0
    modes: int = 1
    background: float = 0.0
    filter_background: float = 0.0
    dark: float = 0.0
    signal: float = 0.0
    steps: int = BRIGHT_STEPS

    @property
    def photons_per_grain(self) -> float:
        """Expected photoelectrons of the object per frame and grain of its bounding box."""
        return self.signal * self.model.grid.pixels_per_grain

    @property
    def background_fraction(self) -> float:
        """Fraction of the light that is not the object's; the shift of the calibration is not light."""
        light = max(self.background - self.dark, 0.0)
        return light / (light + self.signal)

    def calibrate(self, modes: int) -> FrameRetrieval:
        """Return the retrieval with a number of polarisation modes."""
        with one_torch_thread():
            first = [self._counts(number) for number in self.numbers[:FRAMES_FOR_CALIBRATION]]
            kept = variance_transfer(intensity_spectrum(self.coarse_prior, self.model), self.model)
            grains = float(self.coarse_prior.sum() ** 2 / self.coarse_prior.square().sum()) * self.model.grid.measured_fraction
            background = background_of(first, kept, grains, modes)
        signal = max(float(np.mean([one.signal + one.background for one in first])) - background, 1e-6)
        steps = round(self.effort * search_steps(signal * self.model.grid.pixels_per_grain))
        dark = first[0].background
        return replace(
            self, modes=modes, background=background, filter_background=background, dark=dark, signal=signal, steps=steps
        )

    def retrieve(self, job: tuple[torch.Tensor, int, torch.Tensor | None]) -> FrameOutcome:
        """Return the outcome of one frame.

        Args:
            job: prior, number of the frame, and its field of an earlier pass.
        """
        prior, number, start = job
        plain = self._counts(number).to(self.device)
        counts, model = plain.change_background(self.background), self.model
        model = replace(model, transfer=model.transfer.to(self.device))
        prior, start = prior.to(self.device), None if start is None else start.to(self.device)
        target = filter_counts(counts, intensity_spectrum(prior, model, self.modes), model)
        search = Search(model, counts, target, prior, self.modes)
        if start is None:
            random = search.random_field(torch.Generator().manual_seed(self.seed * SEARCH_STREAM + number))
            found = search.run(random, self.steps)
        else:
            found = search.run(start, round(WARM_FRACTION * self.steps))
        posterior = FieldPosterior(model, counts, scale_to_signal(prior, counts.signal / self.modes, model.grid))
        rng = torch.Generator(self.device).manual_seed(self.seed * SAMPLING_STREAM + number)
        mean = Sampling(posterior, rng).run(found, round(WARM_UP_FRACTION * self.steps), round(SAMPLES_FRACTION * self.steps))
        plain = plain.change_background(self.filter_background)
        coarse_spectrum = intensity_spectrum(self.coarse_prior.to(self.device), model)
        filtered = model.grid.on_frame(model.blur(filter_counts(plain, coarse_spectrum, model)))
        prediction = predict_held_out(plain, mean.expected, expected_counts(filtered, plain))
        return FrameOutcome(mean.field.cpu(), mean.power.cpu(), prediction, counts.signal)

    def _counts(self, number: int) -> FrameCounts:
        """Return the counts of a frame, with all of the mean counted as signal."""
        rng = torch.Generator().manual_seed((self.seed + 1) * HELD_OUT_STREAM + number)
        frame, used = self.capture.frames[number], self.capture.measured
        return read_counts(frame, self.calibration, self.model.grid, rng, self.uneven_patch, used)


def search_steps(photons_per_grain: float) -> int:
    """Return the number of steps of a search: more in dim frames."""
    dimness = np.log(BRIGHT_PHOTONS / max(photons_per_grain, 1e-9)) / np.log(BRIGHT_PHOTONS / DIM_PHOTONS)
    return round(BRIGHT_STEPS * (DIM_STEPS / BRIGHT_STEPS) ** float(np.clip(dimness, 0.0, 1.0)))
