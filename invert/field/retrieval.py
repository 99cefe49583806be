"""Retrieval of the fields of a capture: passes over the frames, expectation maximisation, albedo.

Frames are independent given the prior, so threads process them in parallel, each on one core; the result does not depend on their
number.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import parent_process
from typing import Any

import numpy as np
import torch
from scipy import ndimage
from tqdm import tqdm

from correlograph.files.capture import Capture
from correlograph.progress import Progress
from correlograph.ranges import CELLS_PER_LAG
from correlograph.workers import one_torch_thread
from invert.choices import BALANCED, Quality
from invert.field.blending import blend_with_coarse
from invert.field.certificate import Certificate
from invert.field.counts import Calibration
from invert.field.despeckling import Despeckled, despeckle
from invert.field.field import Field
from invert.field.forward_model import ForwardModel, power
from invert.field.frame_retrieval import FRAMES_FOR_CALIBRATION, FrameOutcome, FrameRetrieval
from invert.field.grid import FieldGrid, field_grid
from invert.field.prior import FLOORS, prior_from_albedo, priors_from_albedo
from invert.field.reconstruction import FieldReconstruction
from invert.measure.estimate import Estimate
from invert.measure.spectrum import read_measurement
from invert.methods import Reconstruction
from radiometry.field_forecast import MAX_FIELD_FRAMES, bounding_box
from radiometry.ring_correlation import MIN_CORRELATION

MAX_COARSE_WEIGHT = MIN_CORRELATION
"""Maximum weight of the coarse albedo, as the first prior, in the fine one for which resolution and confidence are stated. Halves that
have nothing else in common then correlate by about as much as those that count as resolved."""

MIN_LIGHT = 0.1
"""Minimum mean of a frame in units of the median over the frames; darker frames are left out."""

MIN_UNPOLARISED_FRACTION = 0.1
"""Minimum background, as a fraction of the counts by one mode, for which two modes are tried; unpolarised light without background
shows 0.29."""


@dataclass(frozen=True)
class Pass:
    """Outcomes of all frames with one prior, and their despeckled intensity."""

    outcomes: Sequence[FrameOutcome]
    albedo: Despeckled

    @classmethod
    def of(cls, outcomes: Sequence[FrameOutcome]) -> Pass:
        """Combine the outcomes of all frames."""
        with one_torch_thread():
            return cls(outcomes, despeckle(intensities(outcomes)))

    @property
    def certificate(self) -> Certificate:
        """Certificate of all frames together."""
        return Certificate.of([one.prediction for one in self.outcomes])

    @property
    def prior_weight(self) -> float:
        """Weight of the prior in the mean |E|^2; the counts have the rest.

        If a field E of variance r is measured with noise of variance n, its posterior under a prior of variance q has the mean
        s (E + noise) with s = q / (q + n), and the variance s n. The expected mean |E|^2 is s^2 r + (1 - s^2) q. If q = r,
        |mean E|^2 over the mean |E|^2 is s. Dynamics that stay near one field make s too large: what a wrong part of the prior keeps lies
        between 1 - s^2 and its square root (`test_the_weight_of_a_wrong_prior_is_not_understated`), which is returned.
        """
        shares = [float(power(one.field).sum() / one.power.sum()) for one in self.outcomes]
        return math.sqrt(max(1.0 - float(np.mean(shares)) ** 2, 0.0))


def intensities(outcomes: Sequence[FrameOutcome]) -> torch.Tensor:
    """Return |E|^2 (frames, modes, box rows, box columns), scaled to the mean signal of the frames."""
    mean = float(np.mean([one.signal for one in outcomes]))
    return torch.stack([one.power * (mean / one.signal) for one in outcomes])


def retrieve_fields(
    capture: Capture,
    estimate: Estimate,
    coarse: Reconstruction,
    seed: int,
    device: str = "cpu",
    quality: Quality = BALANCED,
) -> FieldReconstruction:
    """Retrieve the field of every frame with the coarse albedo as prior, and the fine albedo from all of them.

    Each further pass has the albedo from the fields as prior. Passes end if held-out pixels are predicted worse by a standard error; or
    better by less than one, and either little of the coarse albedo is left or the fields would be rejected.

    Args:
        coarse: reconstruction from the estimate, with an object.
        quality: how many steps and passes are made.

    Raises InputError if the frames undersample the speckle, or hold too little light or too few pixels.
    """
    prepared = replace(prepare(capture, estimate, coarse.albedo, seed, device), effort=quality.field_steps)
    grid, numbers, prior = prepared.model.grid, prepared.numbers, prepared.coarse_prior
    total = len(numbers) * (1 + quality.field_passes) + len(FLOORS) * quality.field_passes
    with tqdm(total=total, desc="fields", unit="frame", disable=None, leave=False) as bar:
        retrieval, done = _choose_modes(prepared, bar.update)

        def run_pass(with_prior: torch.Tensor, starts: Sequence[torch.Tensor | None], done: Sequence[FrameOutcome]) -> Pass:
            jobs = list(zip([with_prior] * len(numbers), numbers, starts, strict=True))[len(done) :]
            return Pass.of([*done, *_in_threads(retrieval.retrieve, jobs, bar.update)])

        best = run_pass(prior, [None] * len(numbers), done)
        coarse_is_certified, coarse_weight = best.certificate.is_accepted, best.prior_weight
        for _ in range(quality.field_passes):
            candidates, starts = priors_from_albedo(best.albedo.albedo), [one.field for one in best.outcomes]
            trials = list(_in_threads(retrieval.retrieve, [(one, numbers[0], starts[0]) for one in candidates], bar.update))
            chosen = int(np.argmax([one.prediction.gain_nats for one in trials]))
            if trials[chosen].prediction.is_worse_than(best.outcomes[0].prediction):
                break
            again = run_pass(candidates[chosen], starts, trials[chosen : chosen + 1])
            change = again.certificate.gain_nats_per_pixel - best.certificate.gain_nats_per_pixel
            if change < -best.certificate.gain_error:
                break
            best, coarse_weight = again, coarse_weight * again.prior_weight
            has_converged = change < best.certificate.gain_error
            if has_converged and (coarse_weight < MAX_COARSE_WEIGHT or not best.certificate.is_accepted):
                break
    fine = best.albedo
    window = _Window(grid, len(coarse.albedo), int(min(max(1, round(1.0 / min(grid.cell_lags))), CELLS_PER_LAG.most)))
    looks = retrieval.modes * len(numbers)
    looks_per_lag = looks / (grid.cell_lags[0] * grid.cell_lags[1])
    shown, weight = blend_with_coarse(window.image(fine.albedo), coarse.albedo, looks_per_lag, coarse.confidence)
    top = max(float(shown.max()), 1e-30)
    # Halves that share a prior that is wrong, or still visible, agree with each other and not with the object.
    halves_are_compared = coarse_is_certified and coarse_weight < MAX_COARSE_WEIGHT
    return FieldReconstruction(
        shown / top,
        window.cells_per_lag,
        best.certificate,
        looks,
        len(numbers),
        weight,
        fine.resolution(grid.cell_lags) if halves_are_compared else None,
        fine.agreement if halves_are_compared else None,
        retrieval.photons_per_grain,
        retrieval.background_fraction,
        coarse_weight,
        None if fine.deviation is None else window.image(fine.deviation) / top,
        window.image(intensities(best.outcomes).mean((0, 1))) / top,
        _field_of(torch.cat([one.field for one in best.outcomes]), grid, capture, estimate),
    )


def prepare(capture: Capture, estimate: Estimate, albedo: np.ndarray, seed: int, device: str = "cpu") -> FrameRetrieval:
    """Return the retrieval of the frames of a capture with an albedo on the lags as prior; `FrameRetrieval.calibrate` completes it.

    Raises InputError like `retrieve_fields`.
    """
    assert estimate.record is not None
    shape, patch = (capture.frames[0].shape[0], capture.frames[0].shape[1]), estimate.record.grid.patch_shape
    grid = field_grid(shape, patch, bounding_box(albedo))
    rows, columns = np.hypot(estimate.blur_pixels or (0.0, 0.0), estimate.path_blur_pixels)
    model = ForwardModel(grid, grid.transfer(capture.camera, (float(rows), float(columns))))
    numbers = bright_frames(capture)
    first = [capture.frames[number] for number in numbers[:FRAMES_FOR_CALIBRATION]]
    gain = capture.file_metadata.gain_e
    floor = read_measurement(estimate.values, estimate.quantisation, estimate.transfer).noise.floor
    calibration = Calibration.of(first, floor, gain and 1.0 / gain, capture.measured)
    uneven = patch if estimate.record.background.uneven_illumination else None
    return FrameRetrieval(capture, numbers, model, calibration, prior_from_albedo(albedo, grid), uneven, seed, device)


def bright_frames(capture: Capture) -> tuple[int, ...]:
    """Return the numbers of the frames that are used: the first `MAX_FIELD_FRAMES` whose mean exceeds `MIN_LIGHT` times the median mean."""
    means = np.array([float(np.mean(capture.frames[number])) for number in range(len(capture.frames))])
    return tuple(
        int(number) for number in np.flatnonzero(means >= MIN_LIGHT * max(float(np.median(means)), 0.0))[:MAX_FIELD_FRAMES]
    )


def _choose_modes(retrieval: FrameRetrieval, progress: Progress) -> tuple[FrameRetrieval, Sequence[FrameOutcome]]:
    """Return the retrieval with one polarisation mode and a background, or with two modes; and the outcome of the first frame, if it is
    known.

    Both explain frames with a contrast below 1; the held-out pixels of the first frame decide.
    """
    single = retrieval.calibrate(1)
    if single.background_fraction < MIN_UNPOLARISED_FRACTION:
        return single, ()
    both = (single, replace(retrieval.calibrate(2), filter_background=single.background))
    job = (retrieval.coarse_prior, retrieval.numbers[0], None)
    trials = list(_in_threads(lambda one: one.retrieve(job), both, progress))
    chosen = int(np.argmax([one.prediction.gain_nats for one in trials]))
    return both[chosen], trials[chosen : chosen + 1]


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
    return Field(fields.numpy(), grid.shape, grid.frame_shape, pitches, camera.wavelength_m, camera.distance_m)


def _in_threads(task: Callable[[Any], Any], jobs: Sequence[Any], progress: Progress) -> Iterator[Any]:
    """Yield the outcomes of a task for all jobs in order, computed in threads with one torch thread each; in one thread if other processes
    share the cores.
    """
    threads = (os.cpu_count() or 1) if parent_process() is None else 1
    with ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        futures = [pool.submit(task, job) for job in jobs]
        try:
            for future in futures:
                yield future.result()
                progress()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
