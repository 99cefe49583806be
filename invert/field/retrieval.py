"""Retrieval of the fields of a capture: prior, search, refinement, certificate, expectation maximisation, albedo.

Frames are independent given the prior, so threads process them in parallel, each on one core; the result does not depend on their
number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from scipy import ndimage
from tqdm import tqdm

from correlograph.files.capture import Capture
from correlograph.workers import one_torch_thread
from invert.field.certificate import Certificate, Prediction, predict_held_out
from invert.field.counts import Calibration, FrameCounts, background_of, read_counts
from invert.field.despeckling import Despeckled, despeckle
from invert.field.field import Field
from invert.field.filtering import filter_counts, intensity_spectrum, variance_transfer
from invert.field.forward_model import ForwardModel, power
from invert.field.grid import FieldGrid, field_grid
from invert.field.prior import FLOORS, bounding_box, prior_from_albedo, priors_from_albedo, scale_to_signal
from invert.field.reconstruction import FieldReconstruction
from invert.field.refinement import Refinement
from invert.field.search import Search
from invert.measure.estimate import Estimate
from invert.measure.spectrum import Measurement
from invert.solvers.base import Progress

BRIGHT_STEPS, DIM_STEPS = 150, 800
"""Steps of a search at `BRIGHT_PHOTONS` or more, and at `DIM_PHOTONS` or fewer photons per grain."""

BRIGHT_PHOTONS, DIM_PHOTONS = 15.0, 5.0
"""Photons per speckle grain of the bounding box; see `BRIGHT_STEPS`."""

WARM_FRACTION = 0.4
"""Steps of a search from the field of an earlier pass, as a fraction of those from a random field."""

REFINEMENT_STEPS = 30
"""Steps of conjugate gradients."""

MAXIMISATIONS = 4
"""Maximum number of times that the prior is replaced by the albedo from the fields; the first that does not improve the prediction of
held-out pixels by a standard error ends them."""

MIN_UNPOLARISED_FRACTION = 0.1
"""Minimum background, as a fraction of the counts by one mode, for which two modes are tried; unpolarised light without background
shows 0.29."""

FRAMES_FOR_CALIBRATION = 8
"""Number of frames from which gain, read noise and background are estimated."""


Outcome = tuple[torch.Tensor, Prediction]
"""Field of one frame (modes, box rows, box columns), and its prediction of the held-out pixels."""


@dataclass(frozen=True)
class Pass:
    """Fields of all frames with one prior (frames, modes, box rows, box columns), their despeckled intensity, and their certificate."""

    fields: torch.Tensor
    albedo: Despeckled
    certificate: Certificate

    @classmethod
    def of(cls, outcomes: Sequence[Outcome]) -> Pass:
        """Combine the outcomes of all frames."""
        fields = torch.stack([field for field, _ in outcomes])
        with one_torch_thread():
            return cls(
                fields, despeckle(power(fields).flatten(0, 1)), Certificate.of([prediction for _, prediction in outcomes])
            )


@dataclass(frozen=True)
class _Problem:
    """What all frames share; `background` belongs to a binned pixel."""

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
        rng = torch.Generator().manual_seed((self.seed + 1) * 7_368_787 + number)
        frame, used = self.capture.frames[number], self.capture.measured
        return read_counts(frame, self.calibration, self.model.grid, rng, self.uneven_patch, used)

    def calibrate(self, prior: torch.Tensor, modes: int) -> tuple[_Problem, float]:
        """Return the problem with a number of polarisation modes, its background and its number of steps; and the photons per grain."""
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
            start = search.random_field(torch.Generator().manual_seed(self.seed * 1_000_003 + number))
            found = search.run(start, self.steps)
        else:
            found = search.run(start, round(WARM_FRACTION * self.steps))
        refinement = Refinement(model, counts, scale_to_signal(prior, counts.signal / self.modes, model.grid))
        state = refinement.run(found, REFINEMENT_STEPS)
        filtered = counts.illumination * model.grid.on_frame(model.blur(target)) + counts.background
        return refinement.field(state).cpu(), predict_held_out(counts, refinement.expected(state), filtered)


def retrieve_fields(
    capture: Capture,
    estimate: Estimate,
    measurement: Measurement,
    albedo: np.ndarray,
    seed: int,
    device: str = "cpu",
) -> FieldReconstruction:
    """Retrieve the field of every frame with the coarse albedo as prior, and the fine albedo from all of them.

    Args:
        albedo: coarse albedo of the estimate, not zero.

    Raises InputError if the frames undersample the speckle.
    """
    assert estimate.record is not None
    frames, patch = capture.frames, estimate.record.grid.patch_shape
    grid = field_grid((frames[0].shape[0], frames[0].shape[1]), patch, bounding_box(albedo))
    gain = capture.file_metadata.gain_e
    calibration = Calibration.of(frames[:FRAMES_FOR_CALIBRATION], measurement.noise.floor, gain and 1.0 / gain)
    model = ForwardModel(grid, grid.transfer(capture.camera, estimate.blur_pixels or (0.0, 0.0)))
    is_uneven = estimate.record.background.uneven_illumination
    prior = prior_from_albedo(albedo, grid)
    total = len(frames) * (1 + MAXIMISATIONS) + len(FLOORS) * MAXIMISATIONS
    with tqdm(total=total, desc="fields", unit="frame", disable=None, leave=False) as bar:
        problem, photons, done = _choose_modes(
            _Problem(capture, model, calibration, patch if is_uneven else None, seed, device), prior, bar.update
        )

        def run_pass(with_prior: torch.Tensor, starts: Sequence[torch.Tensor | None], done: Sequence[Outcome]) -> Pass:
            jobs = [(with_prior, number, starts[number]) for number in range(len(done), len(frames))]
            return Pass.of([*done, *_in_threads(problem.retrieve, jobs, bar.update)])

        best = run_pass(prior, [None] * len(frames), done)
        for _ in range(MAXIMISATIONS):
            candidates = priors_from_albedo(best.albedo.albedo)
            trials = list(_in_threads(problem.retrieve, [(one, 0, best.fields[0]) for one in candidates], bar.update))
            chosen = int(np.argmax([prediction.gain_nats for _, prediction in trials]))
            again = run_pass(candidates[chosen], list(best.fields), trials[chosen : chosen + 1])
            improvement = again.certificate.gain_nats_per_pixel - best.certificate.gain_nats_per_pixel
            if improvement > 0.0:
                best = again
            if improvement < best.certificate.gain_error:
                break
    fields, fine = best.fields, best.albedo
    window = _Window(grid, len(albedo), max(1, round(1.0 / min(grid.cell_lags))))
    top = max(float(fine.albedo.max()), 1e-30)
    return FieldReconstruction(
        window.image(fine.albedo / top),
        window.cells_per_lag,
        best.certificate,
        fields.shape[0] * fields.shape[1],
        fine.resolution(grid.cell_lags),
        fine.agreement,
        photons,
        problem.background / (problem.background + photons / grid.cells_per_grain),
        None if fine.deviation is None else window.image(fine.deviation / top),
        window.image(power(fields).mean((0, 1)) / top),
        _field_of(fields, grid, capture, estimate),
    )


def _choose_modes(problem: _Problem, prior: torch.Tensor, progress: Progress) -> tuple[_Problem, float, Sequence[Outcome]]:
    """Return the problem with one polarisation mode and a background, or with two modes; the photons per grain; and the outcome of the
    first frame, if it is known.

    Both explain frames with a contrast below 1; the held-out pixels of the first frame decide.
    """
    single, photons = problem.calibrate(prior, 1)
    if single.background < MIN_UNPOLARISED_FRACTION * (single.background + photons / problem.model.grid.cells_per_grain):
        return single, photons, ()
    double, all_photons = problem.calibrate(prior, 2)
    trials = list(_in_threads(lambda one: one.retrieve((prior, 0, None)), [single, double], progress))
    gains = [prediction.gain_nats for _, prediction in trials]
    return (single, photons, trials[:1]) if gains[0] >= gains[1] else (double, all_photons, trials[1:])


def search_steps(photons_per_grain: float) -> int:
    """Return the number of steps of a search: more in dim frames."""
    dimness = np.log(BRIGHT_PHOTONS / max(photons_per_grain, 1e-9)) / np.log(BRIGHT_PHOTONS / DIM_PHOTONS)
    return round(BRIGHT_STEPS * (DIM_STEPS / BRIGHT_STEPS) ** float(np.clip(dimness, 0.0, 1.0)))


@dataclass(frozen=True)
class _Window:
    """Window of the coarse albedo (side, side), with `cells_per_lag` pixels per lag."""

    grid: FieldGrid
    side: int
    cells_per_lag: int

    def image(self, cells: torch.Tensor) -> np.ndarray:
        """Interpolate an image on the cells of the box to the window, float32; zero outside the box."""
        centres = (np.arange(self.side * self.cells_per_lag) + 0.5) / self.cells_per_lag - 0.5
        positions = [
            (centres - origin) / width for origin, width in zip(self.grid.origin_lags, self.grid.cell_lags, strict=True)
        ]
        return ndimage.map_coordinates(cells.numpy(), np.meshgrid(*positions, indexing="ij"), order=1, mode="constant")


def _field_of(fields: torch.Tensor, grid: FieldGrid, capture: Capture, estimate: Estimate) -> Field:
    lags, camera = estimate.pitches_m, capture.camera
    pitches = None if lags is None else (grid.cell_lags[0] * lags[0], grid.cell_lags[1] * lags[1])
    return Field(fields.flatten(0, 1).numpy(), grid.shape, grid.frame_shape, pitches, camera.wavelength_m, camera.distance_m)


def _in_threads(task: Callable[[Any], Any], jobs: Sequence[Any], progress: Progress) -> Iterator[Any]:
    """Yield the outcomes of a task for all jobs in order, computed in threads with one torch thread each."""
    with ThreadPoolExecutor(os.cpu_count() or 1, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        futures = [pool.submit(task, job) for job in jobs]
        try:
            for future in futures:
                yield future.result()
                progress()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
