"""Retrieval of the fields of a capture: passes over the frames, expectation maximisation, albedo.

Frames are independent given the prior, so threads process them in parallel, each on one core; the result does not depend on their
number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy import ndimage
from tqdm import tqdm

from correlograph.files.capture import Capture
from correlograph.workers import one_torch_thread
from invert.field.certificate import Certificate, Prediction
from invert.field.counts import Calibration
from invert.field.despeckling import Despeckled, despeckle
from invert.field.field import Field
from invert.field.forward_model import ForwardModel, power
from invert.field.frame_retrieval import FRAMES_FOR_CALIBRATION, FrameRetrieval, Outcome
from invert.field.grid import FieldGrid, field_grid
from invert.field.prior import FLOORS, bounding_box, prior_from_albedo, priors_from_albedo
from invert.field.reconstruction import FieldReconstruction
from invert.measure.estimate import Estimate
from invert.measure.spectrum import Measurement
from invert.solvers.base import Progress

MAXIMISATIONS = 4
"""Maximum number of times that the prior is replaced by the albedo from the fields. They end if the first frame predicts its held-out
pixels no better, or all frames together by less than a standard error."""

MIN_UNPOLARISED_FRACTION = 0.1
"""Minimum background, as a fraction of the counts by one mode, for which two modes are tried; unpolarised light without background
shows 0.29."""


@dataclass(frozen=True)
class Pass:
    """Fields of all frames with one prior (frames, modes, box rows, box columns), their despeckled intensity, and their predictions."""

    fields: torch.Tensor
    albedo: Despeckled
    predictions: Sequence[Prediction]

    @classmethod
    def of(cls, outcomes: Sequence[Outcome]) -> Pass:
        """Combine the outcomes of all frames."""
        fields = torch.stack([field for field, _ in outcomes])
        with one_torch_thread():
            return cls(fields, despeckle(power(fields).flatten(0, 1)), [prediction for _, prediction in outcomes])

    @property
    def certificate(self) -> Certificate:
        """Certificate of all frames together."""
        return Certificate.of(self.predictions)


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
        retrieval, photons, done = _choose_modes(
            FrameRetrieval(capture, model, calibration, patch if is_uneven else None, seed, device), prior, bar.update
        )

        def run_pass(with_prior: torch.Tensor, starts: Sequence[torch.Tensor | None], done: Sequence[Outcome]) -> Pass:
            jobs = [(with_prior, number, starts[number]) for number in range(len(done), len(frames))]
            return Pass.of([*done, *_in_threads(retrieval.retrieve, jobs, bar.update)])

        best = run_pass(prior, [None] * len(frames), done)
        for _ in range(MAXIMISATIONS):
            candidates = priors_from_albedo(best.albedo.albedo)
            trials = list(_in_threads(retrieval.retrieve, [(one, 0, best.fields[0]) for one in candidates], bar.update))
            gains = [prediction.gain_nats for _, prediction in trials]
            chosen = int(np.argmax(gains))
            if gains[chosen] <= best.predictions[0].gain_nats:
                break
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
        retrieval.background / (retrieval.background + photons / grid.cells_per_grain),
        None if fine.deviation is None else window.image(fine.deviation / top),
        window.image(power(fields).mean((0, 1)) / top),
        _field_of(fields, grid, capture, estimate),
    )


def _choose_modes(
    retrieval: FrameRetrieval, prior: torch.Tensor, progress: Progress
) -> tuple[FrameRetrieval, float, Sequence[Outcome]]:
    """Return the retrieval with one polarisation mode and a background, or with two modes; the photons per grain; and the outcome of the
    first frame, if it is known.

    Both explain frames with a contrast below 1; the held-out pixels of the first frame decide.
    """
    single, photons = retrieval.calibrate(prior, 1)
    if single.background < MIN_UNPOLARISED_FRACTION * (single.background + photons / retrieval.model.grid.cells_per_grain):
        return single, photons, ()
    double, all_photons = retrieval.calibrate(prior, 2)
    trials = list(_in_threads(lambda one: one.retrieve((prior, 0, None)), [single, double], progress))
    gains = [prediction.gain_nats for _, prediction in trials]
    return (single, photons, trials[:1]) if gains[0] >= gains[1] else (double, all_photons, trials[1:])


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
